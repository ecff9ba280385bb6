# SPDX-License-Identifier: Apache-2.0
"""Rig time: a clock's, or faster where the rig is emulated and runs faster."""

from __future__ import annotations

import os

from softgrip_time import Clock


class ScaledClock:
    """A `RigClock` whose waits end at once when `stop` is called.

    Args:
        clock: that is scaled.
        scale: rig seconds per second of it; 1 on real hardware.
    """

    def __init__(self, clock: Clock, scale: float = 1.0) -> None:
        self._clock, self._scale = clock, scale
        self._stop = os.eventfd(0)
        self._is_stopped = False

    def __del__(self) -> None:
        os.close(self._stop)

    def now(self) -> float:
        """Return monotonic rig time [s]."""
        return self._clock.now_s() * self._scale

    def wait(self, duration: float) -> bool:
        """Wait [s] of rig time; True at once when stopped."""
        self._clock.wait_readable((self._stop,), self._clock.now_s() + max(duration, 0.0) / self._scale)
        return self._is_stopped

    @property
    def stopped(self) -> bool:
        """True after `stop`."""
        return self._is_stopped

    def stop(self) -> None:
        """End all waits, now and later."""
        self._is_stopped = True
        os.eventfd_write(self._stop, 1)
