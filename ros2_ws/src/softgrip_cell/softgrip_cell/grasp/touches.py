# SPDX-License-Identifier: Apache-2.0
"""Which fingers touch something for sure, and what of their tension is no passing one.

A servo that gets its next goal late falls back and then catches up, and the current that this takes passes for up to
1 N of tension. A computer with other things to do is late for all servos at once: thumb and fingers touch something, by
a few samples. What comes next tells: a servo that has caught up needs less and less, a finger that goes on against
something needs ever more.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from softgrip_cell.grasp.reading import Reading
from softgrip_cell.grasp.settings import GraspSettings

#: Tension that does not grow is a touch all the same once it has stayed for so long [s]: what gives way needs no more.
#: A servo that follows its goals by proportional control has caught up after 0.06 s; the driver's median adds 0.02 s.
LASTS_S: Final = 0.08


class _Touch:
    """One finger's samples since it passed its threshold."""

    def __init__(self, settings: GraspSettings) -> None:
        self._run = settings.run
        self._samples = 0
        self._began_ns = 0
        self._began_n = 0.0
        self._latest_n: deque[float] = deque(maxlen=settings.run)
        self.sure = False

    def look(self, now_ns: int, reading: Reading) -> None:
        """Take a sample."""
        self._latest_n.append(reading.contact_tension_n)
        if not reading.touching:
            self._samples = 0
        elif not self._samples:
            self._began_ns, self._began_n = now_ns, reading.contact_tension_n
        self._samples += reading.touching
        grown = reading.contact_tension_n >= self._began_n
        lasts = now_ns - self._began_ns >= LASTS_S * 1e9
        self.sure = self._samples >= self._run and (grown or lasts)

    @property
    def kept_n(self) -> float:
        """Excess tension that no sample of a run is below [N]."""
        return min(self._latest_n) if len(self._latest_n) == self._run else -math.inf


class Touches:
    """Follows the excess tension of all fingers."""

    def __init__(self, slots: int, settings: GraspSettings) -> None:
        self._touches = tuple(_Touch(settings) for _ in range(slots))

    def look(self, now_ns: int, readings: Sequence[Reading]) -> None:
        """Take the readings of a sample."""
        for touch, reading in zip(self._touches, readings, strict=True):
            touch.look(now_ns, reading)

    @property
    def sure(self) -> tuple[bool, ...]:
        """Which fingers touch something."""
        return tuple(touch.sure for touch in self._touches)

    @property
    def kept_n(self) -> tuple[float, ...]:
        """Excess tension of every finger that no sample of a run is below [N]; -infinity before the first run."""
        return tuple(touch.kept_n for touch in self._touches)
