# SPDX-License-Identifier: Apache-2.0
"""The time of a bag that is played: faster or slower than the wall's, and standing while it is paused."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

#: [s] no sleep is shorter.
_ARRIVED = 1e-6


class Pace:
    """Where the playing stands.

    Args:
        rate: bag seconds per wall second; 0 = as fast as possible.
        tick: told the position [s] at least every ``period`` while time passes, and at every position waited for.
        period: [s] of the wall.
        paused: stand until `toggle`.
    """

    def __init__(self, rate: float, tick: Callable[[float], None], period: float, *, paused: bool = False) -> None:
        self._rate = rate
        self._tick = tick
        self._period = period
        self._lock = threading.Lock()
        self._going = threading.Event()
        self._anchor = 0.0
        self._since = time.monotonic()
        if not paused:
            self._going.set()

    @property
    def paused(self) -> bool:
        """Whether the bag's time stands."""
        return not self._going.is_set()

    def toggle(self) -> None:
        """Pause, or go on."""
        with self._lock:
            if self._going.is_set():
                self._anchor = self._position()
                self._going.clear()
            else:
                self._since = time.monotonic()
                self._going.set()

    def wait_for(self, position: float) -> None:
        """Return when the bag's time has come to a position [s]; the first one starts it."""
        while True:
            while not self._going.wait(self._period):
                self._tick(self._anchor)
            with self._lock:
                rest = 0.0 if self._rate == 0.0 else (position - self._position()) / self._rate
            if rest <= _ARRIVED and not self.paused:
                self._tick(position)
                return
            self._tick(position - max(0.0, rest) * self._rate)
            time.sleep(max(0.0, min(rest, self._period)))

    def _position(self) -> float:
        return self._anchor + (time.monotonic() - self._since) * self._rate if self._going.is_set() else self._anchor
