# SPDX-License-Identifier: Apache-2.0
"""Whether the gauge in a stage's tendon may be believed: a cell that is cut, reversed or has drifted pulls too far.

A slack tendon and a cut cell read the same, so nothing that the stage does before the tendon is taut can tell them
apart. A person's hand can: before anything is wound in, it pulls the tendon until the gauge shows it (a functional
test, as for any sensor that a safety function needs). A reading far below nothing is a fault at any time.
"""

from __future__ import annotations

import statistics

#: [N] A tendon can not push: less than that is a zero that drifted, or a reversed cell.
MAX_NEGATIVE_N = 2.0
#: so many readings in a row, as one may be damaged
NEGATIVE_READINGS = 3
#: readings at the beginning whose median is the level that a hand pulls from
REST_READINGS = 5


class GaugeGuard:
    """Judges the readings of one gauge from its opening on.

    Args:
        proof_n: [N] that a hand must pull before the gauge is believed; 0 = believed at once.
    """

    def __init__(self, proof_n: float) -> None:
        self._proof_n = proof_n
        self._is_proven = proof_n == 0.0
        self._first: list[float] = []
        self._rest = 0.0
        self._negative = 0
        self._last = 0.0
        self._reversed = ""

    @property
    def fault(self) -> tuple[str, str]:
        """Name in the fault table and what was found; empty names where the gauge may be believed."""
        if self._reversed:
            return "gauge_reversed", self._reversed
        if self._negative >= NEGATIVE_READINGS:
            return "gauge_negative", f"expected at least {-MAX_NEGATIVE_N:g} N, found {self._last:.2f} N"
        if self._is_proven:
            return "", ""
        return (
            "gauge_unproven",
            f"expected a hand that pulls the tendon until the gauge shows {self._proof_n:g} N more, found none yet",
        )

    def observe(self, pull: float) -> None:
        """Take a reading [N]."""
        self._last = pull
        self._negative = self._negative + 1 if pull < -MAX_NEGATIVE_N else 0
        if self._is_proven:
            return
        if len(self._first) < REST_READINGS:
            self._first.append(pull)
            self._rest = statistics.median(self._first)
        else:
            self._observe_hand(pull)

    def _observe_hand(self, pull: float) -> None:
        """See which way the reading goes when a hand pulls."""
        if pull >= self._rest + self._proof_n:
            self._is_proven = True
        elif pull <= self._rest - self._proof_n:
            if pull <= -0.5 * self._proof_n:
                self._reversed = f"expected a pull to read more than {self._rest:.2f} N, found {pull:.2f} N"
            # The hand pulled already when the gauge was opened, and has let go.
            self._rest = pull
