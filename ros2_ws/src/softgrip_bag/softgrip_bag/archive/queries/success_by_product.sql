-- Share of grasps that hold, by product and finger set, with a 95 % Wilson interval.
WITH counts AS (
  SELECT product, finger_set, count(*) AS grasps, count(*) FILTER (outcome = 'GRIPPED') AS gripped FROM grasps
  WHERE outcome IN ('GRIPPED', 'EMPTY', 'SLIPPED') GROUP BY ALL
)
SELECT product, finger_set, grasps, gripped, gripped / grasps AS share,
  greatest(0, (gripped + 1.92 - 1.96 * sqrt(gripped * (grasps - gripped) / grasps + 0.96)) / (grasps + 3.84)) AS low,
  least(1, (gripped + 1.92 + 1.96 * sqrt(gripped * (grasps - gripped) / grasps + 0.96)) / (grasps + 3.84)) AS high
FROM counts ORDER BY product, finger_set
