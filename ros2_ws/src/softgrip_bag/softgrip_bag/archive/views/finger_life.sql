-- Each printed finger (by its serial): where it was mounted, from when to when, in how many bags, and grasps that ended with it.
WITH states AS (
  SELECT cell, bag, received, lead(received) OVER (PARTITION BY bag ORDER BY received) AS until, mounted FROM cell_state
), ended AS (
  SELECT states.bag, states.received, count(*) AS grasps FROM grasps JOIN states ON grasps.bag = states.bag
    AND stamp >= received AND (until IS NULL OR stamp < until) GROUP BY ALL
), mounted AS (
  SELECT cell, bag, received, coalesce(grasps, 0) AS grasps, unnest(mounted) AS one FROM states
    LEFT JOIN ended USING (bag, received)
)
SELECT cell, one.serial AS serial, one.finger AS slot, one.profile AS profile, min(received) AS first_seen,
  max(received) AS last_seen, count(DISTINCT bag) AS bags, sum(grasps)::BIGINT AS grasps
FROM mounted WHERE one.serial != '' GROUP BY ALL
