-- Tip error of each finger, bag by bag: a finger that wears drifts away from its prediction.
SELECT profile, finger, bags.start AS start, frames, tip_error_mean, tip_error_max,
  tip_error_mean - first_value(tip_error_mean) OVER (PARTITION BY closings.cell, profile, finger ORDER BY bags.start) AS drift
FROM closings JOIN bags USING (bag) ORDER BY profile, finger, start
