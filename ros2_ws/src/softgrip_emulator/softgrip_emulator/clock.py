# SPDX-License-Identifier: Apache-2.0
"""The emulated cell's own clocks."""

from __future__ import annotations

import time
from typing import Protocol


class CellClock(Protocol):
    """Monotonic cell time [s] that starts at zero; where it follows the computer's, `scale` times as fast."""

    scale: float

    def now_s(self) -> float:
        """Cell time [s]."""
        ...


class RealTimeClock:
    """Cell time that is the computer's, for a device on a wire without a cell around it."""

    scale = 1.0

    def __init__(self) -> None:
        self._began_s = time.monotonic()

    def now_s(self) -> float:
        """See `CellClock`."""
        return time.monotonic() - self._began_s


class SetClock:
    """Cell time that stands where somebody has set it."""

    scale = 1.0

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """See `CellClock`."""
        return self._now_s

    def set(self, now_s: float) -> None:
        """Go on to a time [s]; never back."""
        self._now_s = max(self._now_s, now_s)


class ScaledCellClock:
    """Another clock's time, running faster.

    Args:
        clock: the other one.
        scale: how much faster, 0.001 .. 10000.

    Raises:
        ValueError: no such scale.
    """

    def __init__(self, clock: CellClock, scale: float) -> None:
        if not 1e-3 <= scale <= 1e4:
            raise ValueError(f"clock scale: expected a factor in 0.001..10000, found {scale}; 1 is real time")
        self.scale = scale
        self._clock = clock

    def now_s(self) -> float:
        """See `CellClock`."""
        return self._clock.now_s() * self.scale
