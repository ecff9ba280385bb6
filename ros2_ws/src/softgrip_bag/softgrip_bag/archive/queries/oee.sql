-- Overall equipment effectiveness of each cell and day: availability * performance * quality (definitions: docs/archive.md).
WITH time AS (
  SELECT cell, date, sum(duration_s) AS total_s, sum(duration_s) FILTER (mode IN ('FAULT', 'ESTOP')) AS down_s
  FROM modes GROUP BY ALL
), best AS (
  SELECT product, quantile_cont(duration_s, 0.1) AS ideal_s FROM grasps WHERE outcome = 'GRIPPED' GROUP BY ALL
), work AS (
  SELECT cell, date, count(*) AS grasps, count(*) FILTER (outcome = 'GRIPPED') AS gripped,
    sum(ideal_s) AS ideal_s, sum(duration_s) AS spent_s FROM grasps LEFT JOIN best USING (product) GROUP BY ALL
), factors AS (
  SELECT cell, date, grasps, 1 - coalesce(down_s, 0) / total_s AS availability,
    CASE WHEN spent_s > 0 THEN least(1, ideal_s / spent_s) END AS performance, gripped / nullif(grasps, 0) AS quality
  FROM time LEFT JOIN work USING (cell, date) WHERE total_s > 0
)
SELECT *, availability * performance * quality AS oee FROM factors ORDER BY cell, date
