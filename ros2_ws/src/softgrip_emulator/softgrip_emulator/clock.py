# SPDX-License-Identifier: Apache-2.0
"""The emulated cell's own clock: monotonic time, optionally running faster than the wall's."""

from __future__ import annotations

import time


class CellClock:
    """Monotonic cell time [s] that starts at zero and runs `scale` times as fast as the wall clock.

    Changing the scale never makes the time jump: the past keeps the scale it was lived at.
    """

    def __init__(self, scale: float = 1.0) -> None:
        self._scale = _checked_scale(scale)
        self._wall_epoch_s = time.monotonic()

    @property
    def scale(self) -> float:
        """Cell seconds per wall second."""
        return self._scale

    def now_s(self) -> float:
        """Cell time [s]."""
        return (time.monotonic() - self._wall_epoch_s) * self._scale

    def wall_duration_s(self, cell_duration_s: float) -> float:
        """How long the wall clock takes for a span of cell time [s]."""
        return cell_duration_s / self._scale


def _checked_scale(scale: float) -> float:
    if not 1e-3 <= scale <= 1e4:
        raise ValueError(f"clock scale: expected a factor in 0.001..10000, found {scale}; 1 is real time")
    return scale
