-- Latency of each result from the message that it was computed from, over all bags: the median bag and the worst [ms].
SELECT source, result, count(*) AS bags, sum(matched) AS results, sum(unanswered) AS unanswered,
  1e3 * median(from_publication_p50_s) AS p50_ms, 1e3 * median(from_publication_p95_s) AS p95_ms,
  1e3 * median(from_publication_p99_s) AS p99_ms, 1e3 * max(from_publication_p99_s) AS worst_p99_ms
FROM latencies GROUP BY ALL ORDER BY source, result
