# SPDX-License-Identifier: Apache-2.0
"""Rig time: real time, or faster where the rig is emulated and runs faster."""

from __future__ import annotations

import threading
import time


class ScaledClock:
    """A `RigClock` whose waits end at once when `stop` is called.

    Args:
        scale: rig seconds per wall second; 1 on real hardware.
    """

    def __init__(self, scale: float = 1.0) -> None:
        self._scale = scale
        self._stop = threading.Event()

    def now(self) -> float:
        """Monotonic rig time [s]."""
        return time.monotonic() * self._scale

    def wait(self, duration: float) -> bool:
        """Wait [s] of rig time; True at once when stopped."""
        return self._stop.wait(max(duration, 0.0) / self._scale)

    @property
    def stopped(self) -> bool:
        """True after `stop`."""
        return self._stop.is_set()

    def stop(self) -> None:
        """End all waits, now and later."""
        self._stop.set()
