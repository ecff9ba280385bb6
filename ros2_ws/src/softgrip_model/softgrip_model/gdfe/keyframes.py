# SPDX-License-Identifier: Apache-2.0
"""Equilibria along a closing that shapes are started from, each computed when a shape first needs it.

Keyframes of the chain are extrapolated from those before and lie far apart; halfway between two of them another one is
interpolated where a shape falls in between. All follow from the chain, not from the order of what is asked for.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np

from softgrip_model.gdfe.solver import Equilibrium, State

#: Shares of the keyframes' distance between rest and the first of them: from slack to taut a shape changes fastest.
FIRST_STEPS = (0.05, 0.2, 0.5)
#: Keyframes that the next one is extrapolated from, and that the one halfway is interpolated from.
AHEAD, AROUND = 3, 4


class Keyframes:
    """Keyframes of one closing.

    Args:
        spacing_mm: pulled length between them.
        travel_mm: longest pulled length.
        tolerance_mm: of a pulled length.
        solve: pulled length [mm], state to start from -> equilibrium.
        rest: the undeformed state.
    """

    def __init__(
        self,
        spacing_mm: float,
        travel_mm: float,
        tolerance_mm: float,
        solve: Callable[[float, State], Equilibrium],
        rest: State,
    ) -> None:
        count = round(travel_mm / spacing_mm)
        self._lengths = [0.0, *(spacing_mm * share for share in FIRST_STEPS), *(spacing_mm * np.arange(1, count + 1))]
        self._tolerance, self._solve, self._rest = tolerance_mm, solve, rest
        self._known: list[Equilibrium] = []
        self._halfway: dict[int, Equilibrium] = {}
        self._ended = False

    @property
    def reach_mm(self) -> float:
        """Longest pulled length that a keyframe is known for."""
        return float(self._lengths[max(0, len(self._known) - 1)])

    @property
    def last(self) -> Equilibrium:
        """The one at the reach."""
        return self._known[-1]

    @property
    def solved(self) -> int:
        """How many were computed."""
        return len(self._known)

    def missing(self, pulled_mm: float) -> int:
        """Return how many are left to compute for a shape at a length."""
        return 0 if self._ended else max(0, self._above(pulled_mm) + 1 - len(self._known))

    def covers(self, pulled_mm: float) -> bool:
        """Say whether nothing is left to compute for a shape at a length."""
        return self.missing(pulled_mm) == 0

    def advance(self) -> None:
        """Compute one more; none beyond the travel or beyond one that does not converge."""
        if self._ended:
            return
        count = len(self._known)
        if count == len(self._lengths):
            self._ended = True
            return
        length = float(self._lengths[count])
        before = range(max(0, count - AHEAD), count)
        found = self._solve(length, _through([self._at(k) for k in before], length) if count > 1 else self._rest)
        if found.converged or not self._known:
            self._known.append(found)
        else:
            self._ended = True

    def cover(self, pulled_mm: float) -> None:
        """Compute what a shape at a length needs."""
        while not self.covers(pulled_mm):
            self.advance()

    def within_reach(self, pulled_mm: float) -> bool:
        """Say whether a length lies within the reach; `cover` it first."""
        return pulled_mm <= self.reach_mm + self._tolerance

    def start(self, pulled_mm: float) -> State:
        """Return the interpolated state at a length that is covered."""
        above = min(self._above(pulled_mm), len(self._known) - 1)
        near = []
        for k in range(max(0, above - 2), above + 1):
            if k > max(0, above - 2):
                near += self._between(k)
            near.append(self._at(k))
        return _through(near, pulled_mm)

    def nearest(self, pulled_mm: float) -> Equilibrium:
        """Return the known one nearest to a length."""
        lengths = np.asarray(self._lengths[: len(self._known)])
        return self._known[int(np.argmin(np.abs(lengths - pulled_mm)))]

    def _above(self, pulled_mm: float) -> int:
        """Return the number of the first at or beyond a length."""
        return bisect_left(self._lengths, pulled_mm - self._tolerance)

    def _at(self, number: int) -> tuple[float, Equilibrium]:
        return float(self._lengths[number]), self._known[number]

    def _between(self, number: int) -> list[tuple[float, Equilibrium]]:
        """Return the one halfway to the keyframe before; none where that does not converge."""
        length = 0.5 * float(self._lengths[number - 1] + self._lengths[number])
        if number not in self._halfway:
            near = [self._at(k) for k in range(max(0, number + 1 - AROUND), number + 1)]
            self._halfway[number] = self._solve(length, _through(near, length))
        found = self._halfway[number]
        return [(length, found)] if found.converged else []


def _through(near: Sequence[tuple[float, Equilibrium]], pulled_mm: float) -> State:
    """Return Lagrange's polynomial through equilibria at lengths, at another length [mm]."""
    at = [length for length, _ in near]
    weights = [np.prod([(pulled_mm - other) / (own - other) for other in at if other != own]) for own in at]
    known = [equilibrium for _, equilibrium in near]
    displacement = sum(w * one.displacement for w, one in zip(weights, known, strict=True))
    tension = sum(w * one.anchor_tension[0] for w, one in zip(weights, known, strict=True))
    return State(np.asarray(displacement), (max(0.0, float(tension)),))
