-- Each printed finger (by its serial): where it was mounted, from when to when, and in how many bags.
WITH mounted AS (SELECT cell, bag, received, unnest(mounted) AS one FROM cell_state)
SELECT cell, one.serial AS serial, one.finger AS slot, one.profile AS profile, min(received) AS first_seen,
  max(received) AS last_seen, count(DISTINCT bag) AS bags FROM mounted WHERE one.serial != '' GROUP BY ALL
