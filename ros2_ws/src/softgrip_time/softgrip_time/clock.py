# SPDX-License-Identifier: Apache-2.0
"""What code that waits is given: the time, and ways to wait for it or for bytes."""

from __future__ import annotations

import select
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from softgrip_time.units import to_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from contextlib import AbstractContextManager


class Clock(Protocol):
    """Monotonic time [s] and waits; may be used from several threads."""

    def now_s(self) -> float:
        """Return the time [s]; its zero means nothing."""

    def epoch_ns(self, at_s: float) -> int:
        """Return the time since the epoch [ns] at a time of this clock [s]."""

    def wait(self, until_s: float) -> None:
        """Return when the time has come; at once when it is past."""

    def wait_readable(self, files: Sequence[int], until_s: float) -> list[int]:
        """Wait until a file can be read or the time has come.

        Args:
            files: file descriptors.
            until_s: [s] of this clock.

        Returns:
            those that can be read; empty when the time has come first.
        """

    def attach(self, device: int) -> None:
        """Register the file descriptor of a terminal with a device behind it; `detach` before it is closed."""

    def detach(self, device: int) -> None:
        """Forget a terminal; no effect on one that is not attached."""

    def count_written(self, device: int, size: int) -> None:
        """Count bytes written to a device: simulated time stands until the device has received them."""

    def stepping(self) -> AbstractContextManager[None]:
        """Hold simulated time unless this thread waits; the computer's time runs on. Not nested."""

    def detached(self) -> AbstractContextManager[None]:
        """Within `stepping`: let simulated time run while this thread waits for something other than this clock."""


class WallClock:
    """The computer's own time."""

    def now_s(self) -> float:
        """See `Clock`."""
        return time.monotonic()

    def epoch_ns(self, at_s: float) -> int:
        """See `Clock`."""
        return time.time_ns() - to_ns(time.monotonic() - at_s)

    def wait(self, until_s: float) -> None:
        """See `Clock`."""
        time.sleep(max(0.0, until_s - time.monotonic()))

    def wait_readable(self, files: Sequence[int], until_s: float) -> list[int]:
        """See `Clock`."""
        return select.select(files, (), (), max(0.0, until_s - time.monotonic()))[0]

    def attach(self, device: int) -> None:
        """See `Clock`."""

    def detach(self, device: int) -> None:
        """See `Clock`."""

    def count_written(self, device: int, size: int) -> None:
        """See `Clock`."""

    @contextmanager
    def stepping(self) -> Iterator[None]:
        """See `Clock`."""
        yield

    @contextmanager
    def detached(self) -> Iterator[None]:
        """See `Clock`."""
        yield
