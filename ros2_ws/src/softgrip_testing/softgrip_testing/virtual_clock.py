# SPDX-License-Identifier: Apache-2.0
"""A time that passes only while somebody waits for it: exact, and the same on every computer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from softgrip_time import WallClock

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

#: Longest step in which what lives along is advanced [s]: the period of the emulator's plant thread.
PLANT_PERIOD_S = 0.003


class VirtualClock(WallClock):
    """A `softgrip_time.Clock` and the emulator's clock in one; its time [s] passes only while somebody waits.

    Args:
        now_s: where the time begins [s].
    """

    #: the emulator's devices ask how fast time runs
    scale = 1.0

    def __init__(self, now_s: float = 0.0) -> None:
        self._now_s = now_s
        #: each is called with the time [s] of every step
        self.living: list[Callable[[float], None]] = []

    def now_s(self) -> float:
        """Return the time [s]."""
        return self._now_s

    def wait(self, until_s: float) -> None:
        """Let the time pass until then [s]; no effect when it is past."""
        self.advance(until_s)

    def wait_readable(self, files: Sequence[Any], until_s: float) -> list[Any]:
        """Let the time pass until a handle has bytes, or a time [s]; a handle's `wait` takes the seconds left."""
        return list(files) if files[0].wait(until_s - self._now_s) else []

    def advance(self, until_s: float) -> None:
        """Let everything live until a time [s]."""
        while self._now_s < until_s:
            self._now_s = min(until_s, self._now_s + PLANT_PERIOD_S) if self.living else until_s
            for live in self.living:
                live(self._now_s)


class VirtualRigClock:
    """The driver's `RigClock` on a `VirtualClock`.

    Attributes:
        stopped: all waits end with True.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.stopped = False

    def now(self) -> float:
        """Return the rig's time [s]."""
        return self._clock.now_s()

    def wait(self, duration: float) -> bool:
        """Let time pass [s]; return whether the rig has been stopped."""
        self._clock.wait(self._clock.now_s() + duration)
        return self.stopped

    def stop(self) -> None:
        """End all waits."""
        self.stopped = True
