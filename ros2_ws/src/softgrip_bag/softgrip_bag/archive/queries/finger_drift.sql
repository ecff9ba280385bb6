-- Tip error of each printed finger (by its serial) moving free, bag by bag: one that wears drifts away from its prediction.
WITH slots AS (
  SELECT bag, received, mode_name, unnest(mounted) AS one FROM cell_state
), mounted AS (
  SELECT bag, received, mode_name, one.finger AS finger, one.serial AS serial, one.profile AS profile FROM slots
), errors AS (
  SELECT r.cell, r.bag, serial, profile, r.finger, count(*) AS frames, avg(tip_error_percent) AS tip_error_mean,
    max(tip_error_percent) AS tip_error_max
  FROM finger_residual AS r ASOF JOIN mounted AS m ON r.bag = m.bag AND r.finger = m.finger AND r.received >= m.received
  WHERE serial != '' AND mode_name NOT IN ('GRASPING', 'HOLDING') AND isfinite(tip_error_percent) GROUP BY ALL
)
SELECT errors.cell, serial, profile, finger, bags.start AS start, frames, tip_error_mean, tip_error_max,
  tip_error_mean - first_value(tip_error_mean) OVER (PARTITION BY errors.cell, serial ORDER BY bags.start) AS drift
FROM errors JOIN bags USING (bag) ORDER BY errors.cell, serial, start
