-- How grasps ended, day by day.
SELECT date, cell, outcome, count(*) AS grasps FROM grasps GROUP BY ALL ORDER BY date, cell, outcome
