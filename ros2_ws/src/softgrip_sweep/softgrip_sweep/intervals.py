# SPDX-License-Identifier: Apache-2.0
"""How sure a share is."""

from __future__ import annotations

from scipy.stats import binomtest

CONFIDENCE = 0.95


def wilson(hits: int, tries: int) -> tuple[float, float]:
    """Return the Wilson score interval of a share at 95 %, as the archive's questions use it.

    Args:
        hits: how often it happened.
        tries: how often it could have, at least once.

    Raises:
        ValueError: more hits than tries, or none tried.
    """
    found = binomtest(hits, tries).proportion_ci(CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)
