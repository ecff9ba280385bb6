-- What went wrong most often, and when last.
SELECT source, name, count(*) AS times, count(DISTINCT bag) AS bags, max(stamp) AS last FROM alarms
GROUP BY ALL ORDER BY times DESC, source, name
