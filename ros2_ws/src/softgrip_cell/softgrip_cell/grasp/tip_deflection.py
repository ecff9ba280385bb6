# SPDX-License-Identifier: Apache-2.0
"""Fingers that the camera sees away from where they would be if they touched nothing.

A finger that has nothing in its way takes the predicted shape whatever its tension. One that leans on a product is bent
otherwise at the same pulled length: tens of millimetres at the tip of a power finger, where the tension beside the free
motion tells little, as free motion is not what it does.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.observation import ObservedPair, SeenTip

#: Predictions are kept so long for frames that are on their way [s].
KEPT_S: Final = 0.5

#: A frame is compared with the prediction nearest to its stamp, at most so far from it [s].
PAIR_S: Final = 0.05

#: A frame older than this says nothing of now [s].
FRESH_S: Final = 0.1

#: Beyond the path that the check has covered a fingertip has to be so many times farther off to tell something.
UNCHECKED: Final = 2.0


class TipDeflection:
    """Compares seen fingertips with predicted ones."""

    def __init__(self, slots: Sequence[str], references: Sequence[FreeReference], settings: GraspSettings) -> None:
        self._slots = tuple(slots)
        self._references = tuple(references)
        self._settings = settings
        self._pairs: deque[ObservedPair] = deque()
        self._off: dict[int, tuple[int, float, float]] = {}

    def predict(self, pair: ObservedPair) -> None:
        """Take a tendon sample with its prediction."""
        self._pairs.append(pair)
        while self._pairs[0].sample.stamp_ns < pair.sample.stamp_ns - KEPT_S * 1e9:
            self._pairs.popleft()

    def see(self, tip: SeenTip) -> None:
        """Take a fingertip; one without a prediction of its time tells nothing."""
        if tip.slot not in self._slots or not self._pairs:
            return
        slot = self._slots.index(tip.slot)
        pair = min(self._pairs, key=lambda each: abs(each.sample.stamp_ns - tip.stamp_ns))
        if abs(pair.sample.stamp_ns - tip.stamp_ns) > PAIR_S * 1e9:
            return
        off_m = math.dist(tip.tip_m, pair.free.tip_m[slot])
        if math.isfinite(off_m):
            stddev_m = tip.stddev_m if math.isfinite(tip.stddev_m) else 0.0
            checked = pair.sample.pulled_m[slot] <= self._references[slot].reach_m
            max_m = self._settings.tip_m * (1.0 if checked else UNCHECKED)
            self._off[slot] = (tip.stamp_ns, off_m, max_m + 3.0 * stddev_m)

    def off_m(self, now_ns: int) -> dict[int, float]:
        """Distance of every slot's fingertip that was seen a moment ago from its predicted place [m]."""
        return {slot: off_m for slot, (at_ns, off_m, _) in self._off.items() if now_ns - at_ns <= FRESH_S * 1e9}

    def slots(self, now_ns: int) -> frozenset[int]:
        """Slots whose finger leans on something."""
        fresh = self.off_m(now_ns)
        return frozenset(slot for slot, (_, off_m, max_m) in self._off.items() if slot in fresh and off_m > max_m)
