# SPDX-License-Identifier: Apache-2.0
"""Has one finger of a hand changed, or all of them alike? Heat softens all; a motor's gain is its own.

No closing of one finger tells softer strips from a motor that reads less (docs/finger.md). The others do: three changes
of one amount at once are one cause. What is compared is "all moved by one unknown amount" with "each moved, or did not,
by itself", as the marginal likelihoods of the amounts that the fingers' closings give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: Odds that something changes about a finger between two closings.
_CHANGE_ODDS = 0.01
#: Relative: what heat does to one finger beside the next.
_APART = 0.01


@dataclass(frozen=True)
class Softening:
    """Relative change of a finger's moduli, were it the only change: likeliest amount and standard deviation."""

    amount: float
    stddev: float


def log_odds_of_heat(own: Softening, others: Sequence[Softening], stddev: float) -> float:
    """Return the log odds that all fingers of a hand were softened by one amount, beside each by its own.

    Args:
        own: of the finger that is asked about; it has changed.
        others: of the other fingers of the hand, which may not have.
        stddev: of such an amount before anything was seen.
    """
    amounts = np.array([own.amount, *(one.amount for one in others)])
    noise = np.diag([one.stddev**2 + _APART**2 for one in (own, *others)])
    odds = _log_normal(amounts, stddev**2 + noise) - _log_normal(amounts[:1], stddev**2 + noise[:1, :1])
    for place in range(1, len(amounts)):
        one, variance = amounts[place : place + 1], noise[place : place + 1, place : place + 1]
        still = math.log1p(-_CHANGE_ODDS) + _log_normal(one, variance)
        moved = math.log(_CHANGE_ODDS) + _log_normal(one, stddev**2 + variance)
        odds -= float(np.logaddexp(still, moved))
    return odds


def _log_normal(value: np.ndarray, covariance: np.ndarray) -> float:
    return -0.5 * float(value @ np.linalg.solve(covariance, value) + np.linalg.slogdet(2.0 * math.pi * covariance)[1])
