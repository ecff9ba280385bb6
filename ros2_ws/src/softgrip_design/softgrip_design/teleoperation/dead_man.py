# SPDX-License-Identifier: Apache-2.0
"""The dead-man switch: motion only while a key or a pedal says so, again and again."""

from __future__ import annotations

import threading
from typing import Final

#: A press counts for so long [s]. A key repeats every 30 to 40 ms, a pedal has to send at 20 Hz or more.
PRESS_LIFETIME_S: Final = 0.10


class DeadManSwitch:
    """Is held while presses keep coming; may be pressed by one thread and asked by another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._until_s = -1.0

    def press(self, now_s: float) -> None:
        """Take a press at a time of the steady clock [s]."""
        with self._lock:
            self._until_s = now_s + PRESS_LIFETIME_S

    def release(self) -> None:
        """Take that it was let go."""
        with self._lock:
            self._until_s = -1.0

    def is_held(self, now_s: float) -> bool:
        """Return whether the last press is young enough."""
        with self._lock:
            return now_s <= self._until_s
