# SPDX-License-Identifier: Apache-2.0
"""Whether the gauge in a stage's tendon may be believed: a cell that is cut, reversed or has drifted pulls too far.

A slack tendon and a cut cell read the same, so nothing that the stage does before the tendon is taut can tell them
apart. A person's hand can: before anything is wound in, it pulls the tendon until the gauge shows it (a functional
test, as for any sensor that a safety function needs). Once the stage has pulled, it is known where the tendon becomes
taut: a gauge that shows nothing a few millimetres beyond has to be proven again. A reading far below nothing is a fault
at any time.
"""

from __future__ import annotations

import statistics

#: [N] A tendon can not push: less than that is a zero that drifted, or a reversed cell.
MAX_NEGATIVE_N = 2.0
#: so many readings in a row, as one may be damaged
IN_A_ROW = 3
#: share of the proof that shows a taut tendon: less than a homing's tension, more than the noise of a cut cell
SHOWS = 0.5
#: [m] of travel between two readings below which the stage stands: what the gauge begins to show then, a hand pulls
STANDS_M = 2e-5
#: [m] that may be wound in beyond where the gauge showed a taut tendon last, with nothing shown
BLIND_M = 4e-3
#: [m] that a stage which stands may have gone back by itself
GAVE_WAY_M = 2e-4
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
        #: [m] where the stage had the tendon taut last; none before, nor while a hand still pulls
        self._shown_at: float | None = None
        self._is_held_by_hand = self._is_taut = False
        self._before = 0.0
        self._blind = 0
        self._silent = ""
        self._reversed = ""

    @property
    def fault(self) -> tuple[str, str]:
        """Name in the fault table and what was found; empty names where the gauge may be believed."""
        if self._reversed:
            return "gauge_reversed", self._reversed
        if self._negative >= IN_A_ROW:
            return "gauge_negative", f"expected at least {-MAX_NEGATIVE_N:g} N, found {self._last:.2f} N"
        if self._is_proven:
            return "", ""
        asked = f"expected a hand that pulls the tendon until the gauge shows {self._proof_n:g} N more, found none"
        return "gauge_unproven", f"{asked} {self._silent or 'yet'}"

    def observe(self, pull: float, travel: float) -> None:
        """Take a reading [N], and where the stage was [m]."""
        self._last = pull
        self._negative = self._negative + 1 if pull < -MAX_NEGATIVE_N else 0
        if self._is_proven:
            self._observe_stage(pull, travel)
            return
        if len(self._first) < REST_READINGS:
            self._first.append(pull)
            self._rest = statistics.median(self._first)
        else:
            self._observe_hand(pull, travel)

    def _observe_stage(self, pull: float, travel: float) -> None:
        """See whether the gauge still shows what the stage pulls."""
        if self._proof_n == 0.0:
            return
        stands, self._before = abs(travel - self._before) < STANDS_M, travel
        was_taut, self._is_taut = self._is_taut, pull >= SHOWS * self._proof_n
        if self._is_taut:
            self._blind = 0
            self._is_held_by_hand = self._is_held_by_hand or (stands and not was_taut)
            self._shown_at = None if self._is_held_by_hand else travel
            return
        self._is_held_by_hand = False
        is_beyond = self._shown_at is not None and travel > self._shown_at + BLIND_M
        self._blind = self._blind + 1 if is_beyond else 0
        if self._blind >= IN_A_ROW:
            self._ask_again()

    def doubt(self) -> None:
        """Ask for another proof if nothing shows as far in as the tendon was taut last: to be called at a lost zero.

        Either the tendon is broken or the cell's cable is cut, and what homes then may feel nothing.
        """
        if self._shown_at is not None and not self._is_taut and self._before >= self._shown_at - GAVE_WAY_M:
            self._ask_again()

    def _ask_again(self) -> None:
        self._silent = f"since it showed {self._last:.2f} N where the tendon was taut before"
        self._is_proven, self._first = False, []

    def _observe_hand(self, pull: float, travel: float) -> None:
        """See which way the reading goes when a hand pulls."""
        if pull >= self._rest + self._proof_n:
            self._is_proven, self._is_held_by_hand, self._is_taut = True, True, True
            self._shown_at, self._blind, self._silent, self._before = None, 0, "", travel
        elif pull <= self._rest - self._proof_n:
            if pull <= -0.5 * self._proof_n:
                self._reversed = f"expected a pull to read more than {self._rest:.2f} N, found {pull:.2f} N"
            # The hand pulled already when the gauge was opened, and has let go.
            self._rest = pull
