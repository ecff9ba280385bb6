# SPDX-License-Identifier: Apache-2.0
"""Share of time in which the cell could have worked."""

from __future__ import annotations


class Availability:
    """Adds up time with and without a fault.

    Args:
        now_s: when counting starts, of a monotonic clock [s].
    """

    def __init__(self, now_s: float) -> None:
        self._since_s = now_s
        self._start_s = now_s
        self._down_s = 0.0
        self._is_down = False

    def update(self, now_s: float, *, down: bool) -> None:
        """Take the present condition."""
        if self._is_down:
            self._down_s += now_s - self._since_s
        self._since_s = now_s
        self._is_down = down

    def share(self, now_s: float) -> float:
        """Return the share of time without a fault since the start [0..1]; 1 before any time has passed."""
        total_s = now_s - self._start_s
        down_s = self._down_s + (now_s - self._since_s if self._is_down else 0.0)
        return 1.0 if total_s <= 0.0 else 1.0 - down_s / total_s
