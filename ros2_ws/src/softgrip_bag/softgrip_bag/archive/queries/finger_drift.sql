-- Tip error of each printed finger (by its serial) in its free closings, bag by bag: one that wears drifts away from its prediction.
WITH slots AS (
  SELECT bag, received, mode_name, unnest(mounted) AS one FROM cell_state
), mounted AS (
  SELECT bag, received, mode_name, one.finger AS finger, one.serial AS serial, one.profile AS profile FROM slots
), frames AS (
  SELECT r.cell, r.bag, r.received, serial, profile, r.finger, pulled_length, tip_error_percent,
    serial != '' AND mode_name NOT IN ('GRASPING', 'HOLDING', 'FAULT', 'ESTOP') AS can_close
  FROM finger_residual AS r ASOF JOIN mounted AS m ON r.bag = m.bag AND r.finger = m.finger AND r.received >= m.received
), steps AS ( -- as softgrip_bag.closings: a run ends where the pulled length falls
  SELECT *, coalesce(pulled_length - lag(pulled_length) OVER w, 0) AS step,
    coalesce(NOT lag(can_close) OVER w OR lag(serial) OVER w != serial OR step < -1e-4, true) AS begins
  FROM frames WINDOW w AS (PARTITION BY cell, bag, finger ORDER BY received)
), numbered AS (
  SELECT *, sum(begins::INTEGER) OVER (PARTITION BY cell, bag, finger ORDER BY received) AS run FROM steps
), runs AS (
  SELECT *, first_value(pulled_length) OVER w AS open, last_value(pulled_length) OVER w AS closed
  FROM numbered WHERE can_close WINDOW w AS (
    PARTITION BY cell, bag, finger, run ORDER BY received ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING)
), errors AS (
  SELECT cell, bag, serial, profile, finger, count(*) AS frames, avg(tip_error_percent) AS tip_error_mean,
    max(tip_error_percent) AS tip_error_max
  FROM runs WHERE abs(open) <= 1e-3 AND closed - open >= 5e-3 AND NOT begins AND step >= 2e-5 AND isfinite(tip_error_percent)
  GROUP BY ALL
)
SELECT errors.cell, serial, profile, finger, bags.start AS start, frames, tip_error_mean, tip_error_max,
  tip_error_mean - first_value(tip_error_mean) OVER (PARTITION BY errors.cell, serial ORDER BY bags.start) AS drift
FROM errors JOIN bags USING (bag) ORDER BY errors.cell, serial, start
