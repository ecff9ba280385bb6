# SPDX-License-Identifier: Apache-2.0
"""One demonstration after the other: each begins with the dead-man switch and ends with the person's verdict."""

from __future__ import annotations

import threading
from enum import IntEnum


class Phase(IntEnum):
    """What a demonstration does; the values are TeleoperationState's."""

    IDLE = 0
    RUNNING = 1
    SUCCEEDED = 2
    FAILED = 3
    ABORTED = 4


class Demonstrations:
    """Numbers demonstrations, from 1 on; a verdict may come from another thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number, self._phase = 0, Phase.IDLE
        self._is_armed = True

    @property
    def current(self) -> tuple[int, Phase]:
        """Number and phase of the last one."""
        with self._lock:
            return self._number, self._phase

    def observe(self, *, is_held: bool, is_blocked: bool) -> bool:
        """Take the dead-man switch; return whether the fingers may follow.

        A press begins a demonstration where none runs. After a verdict, and after something was in the way, the switch
        has to be let go first: nothing moves because a fault went away.

        Args:
            is_held: the switch.
            is_blocked: something else forbids to move.
        """
        with self._lock:
            self._is_armed = not is_blocked and (self._is_armed or not is_held)
            may_move = is_held and self._is_armed
            if may_move and self._phase is not Phase.RUNNING:
                self._number, self._phase = self._number + 1, Phase.RUNNING
            return may_move

    def end(self, verdict: Phase) -> bool:
        """End the one that runs; return whether one ran."""
        with self._lock:
            if self._phase is not Phase.RUNNING:
                return False
            self._phase, self._is_armed = verdict, False
            return True
