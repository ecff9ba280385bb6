# SPDX-License-Identifier: Apache-2.0
"""Equilibria along a closing that shapes are started from, each computed when a shape first needs it or before.

Keyframes of the chain are extrapolated from those before and lie far apart; halfway between two of them another one is
interpolated where a shape falls in between. All follow from the chain, not from the order of what is asked for. What
another thread has computed ahead is there at once when it is asked for, and leaves no other trace.
"""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np

from softgrip_model.gdfe.solver import Equilibrium, State

#: Shares of the keyframes' distance between rest and the first of them: from slack to taut a shape changes fastest.
FIRST_STEPS = (0.05, 0.2, 0.5)
#: Keyframes that the next one is extrapolated from, and that the one halfway is interpolated from.
AHEAD, AROUND = 3, 4


#: How an equilibrium is found: pulled length [mm], state to start from.
Solve = Callable[[float, State], Equilibrium]


class Keyframes:
    """Keyframes of one closing.

    One thread asks for them; one more may compute `ahead`.

    Args:
        spacing_mm: pulled length between them.
        travel_mm: longest pulled length.
        tolerance_mm: of a pulled length.
        solve: finds an equilibrium.
        rest: the undeformed state.
    """

    def __init__(
        self,
        spacing_mm: float,
        travel_mm: float,
        tolerance_mm: float,
        solve: Solve,
        rest: State,
    ) -> None:
        count = round(travel_mm / spacing_mm)
        self._lengths = [0.0, *(spacing_mm * share for share in FIRST_STEPS), *(spacing_mm * np.arange(1, count + 1))]
        self._tolerance, self._solve, self._rest = tolerance_mm, solve, rest
        self._known: list[Equilibrium] = []
        self._halfway: dict[int, Equilibrium] = {}
        self._asked = 0
        self._end: int | None = None  # how many there are, once that is known
        self._turn = threading.Condition()
        self._busy = False

    @property
    def reach_mm(self) -> float:
        """Longest pulled length that a keyframe was asked for and is known."""
        return float(self._lengths[max(0, self._usable - 1)])

    @property
    def last(self) -> Equilibrium:
        """The one at the reach."""
        return self._known[self._usable - 1]

    @property
    def asked(self) -> int:
        """How many were asked for, whoever computed them."""
        return self._asked

    @property
    def complete(self) -> bool:
        """Whether all that there are have been computed."""
        return self._end is not None

    def missing(self, pulled_mm: float) -> int:
        """Return how many are left to ask for, for a shape at a length."""
        return 0 if self._ended else max(0, self._above(pulled_mm) + 1 - self._asked)

    def covers(self, pulled_mm: float) -> bool:
        """Say whether nothing is left to ask for, for a shape at a length."""
        return self.missing(pulled_mm) == 0

    def advance(self) -> None:
        """Ask for one more; none beyond the travel or beyond one that does not converge."""
        if self._ended:
            return
        self._asked += 1
        while not self._tried(self._asked):
            self._in_turn(lambda: self._tried(self._asked), lambda: self._compute(self._solve))

    def ahead(self, solve: Solve) -> bool:
        """Compute one that nobody asked for yet, and the one halfway to it; False where none is left.

        Args:
            solve: must give the same bits as the one that these keyframes were made with; it is called on this thread.
        """
        if self._end is not None:
            return False
        count = len(self._known)
        self._in_turn(lambda: self._tried(count + 1), lambda: self._compute(solve))
        if self._end is None and count > 0:
            self._halve(count, solve)
        return True

    def cover(self, pulled_mm: float) -> None:
        """Compute what a shape at a length needs."""
        while not self.covers(pulled_mm):
            self.advance()

    def within_reach(self, pulled_mm: float) -> bool:
        """Say whether a length lies within the reach; `cover` it first."""
        return pulled_mm <= self.reach_mm + self._tolerance

    def start(self, pulled_mm: float) -> State:
        """Return the interpolated state at a length that is covered."""
        above = min(self._above(pulled_mm), self._usable - 1)
        near = []
        for k in range(max(0, above - 2), above + 1):
            if k > max(0, above - 2):
                near += self._between(k)
            near.append(self._at(k))
        return _through(near, pulled_mm)

    def nearest(self, pulled_mm: float) -> Equilibrium:
        """Return the known one nearest to a length."""
        lengths = np.asarray(self._lengths[: self._usable])
        return self._known[int(np.argmin(np.abs(lengths - pulled_mm)))]

    def _above(self, pulled_mm: float) -> int:
        """Return the number of the first at or beyond a length."""
        return bisect_left(self._lengths, pulled_mm - self._tolerance)

    def _at(self, number: int) -> tuple[float, Equilibrium]:
        return float(self._lengths[number]), self._known[number]

    def _between(self, number: int) -> list[tuple[float, Equilibrium]]:
        """Return the one halfway to the keyframe before; none where that does not converge."""
        self._halve(number, self._solve)
        found = self._halfway[number]
        return [(self._middle(number), found)] if found.converged else []

    def _middle(self, number: int) -> float:
        return 0.5 * float(self._lengths[number - 1] + self._lengths[number])

    def _halve(self, number: int, solve: Solve) -> None:
        def compute() -> None:
            length = self._middle(number)
            near = [self._at(k) for k in range(max(0, number + 1 - AROUND), number + 1)]
            self._halfway[number] = solve(length, _through(near, length))

        while number not in self._halfway:
            self._in_turn(lambda: number in self._halfway, compute)

    @property
    def _ended(self) -> bool:
        return self._end is not None and self._asked > self._end

    @property
    def _usable(self) -> int:
        """How many of those asked for there are."""
        return self._asked if self._end is None else min(self._asked, self._end)

    def _tried(self, count: int) -> bool:
        return self._end is not None or len(self._known) >= count

    def _compute(self, solve: Solve) -> None:
        """Compute the next of the chain, or find that there is none."""
        count = len(self._known)
        if count == len(self._lengths):
            self._end = count
            return
        length = float(self._lengths[count])
        before = range(max(0, count - AHEAD), count)
        found = solve(length, _through([self._at(k) for k in before], length) if count > 1 else self._rest)
        if found.converged or not self._known:
            self._known.append(found)
        else:
            self._end = count

    def _in_turn(self, done: Callable[[], bool], compute: Callable[[], None]) -> None:
        """Compute when the other thread does not, unless it has done it by then."""
        with self._turn:
            self._turn.wait_for(lambda: done() or not self._busy)
            if done():
                return
            self._busy = True
        try:
            compute()
        finally:
            with self._turn:
                self._busy = False
                self._turn.notify_all()


def _through(near: Sequence[tuple[float, Equilibrium]], pulled_mm: float) -> State:
    """Return Lagrange's polynomial through equilibria at lengths, at another length [mm]."""
    at = [length for length, _ in near]
    weights = [np.prod([(pulled_mm - other) / (own - other) for other in at if other != own]) for own in at]
    known = [equilibrium for _, equilibrium in near]
    displacement = sum(w * one.displacement for w, one in zip(weights, known, strict=True))
    tension = sum(w * one.anchor_tension[0] for w, one in zip(weights, known, strict=True))
    return State(np.asarray(displacement), (max(0.0, float(tension)),))
