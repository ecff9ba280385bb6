# SPDX-License-Identifier: Apache-2.0
"""Stage and gauge together: opened as one, used by one at a time, stopped on every way out."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from softgrip_driver.errors import DriverError
from softgrip_driver.rig.devices import Gauge, Identity, Stage
from softgrip_driver.rig.pull import Sample


class BusyError(DriverError):
    """The rig is already measuring."""


class Bench:
    """The two devices of a rig.

    Args:
        stage: not yet connected.
        gauge: not yet connected.
    """

    def __init__(self, stage: Stage, gauge: Gauge) -> None:
        self.stage, self.gauge = stage, gauge
        self._in_use = threading.Lock()

    def open(self) -> tuple[Identity, Identity]:
        """Connect and identify both.

        Raises:
            DriverError: of whichever is not there; the other one is closed again.
        """
        try:
            return self.stage.open(), self.gauge.open()
        except DriverError:
            self.close()
            raise

    @contextmanager
    def measuring(self) -> Iterator[None]:
        """Have the devices for oneself.

        Raises:
            BusyError: somebody has.
        """
        if not self._in_use.acquire(blocking=False):
            raise BusyError("the rig is measuring already: wait for it, or cancel it first")
        try:
            yield
        finally:
            self._in_use.release()

    def look(self, now: float) -> Sample | None:
        """Read both while nobody measures; None while somebody does.

        Raises:
            DriverError: a device does not answer as it should.
        """
        if not self._in_use.acquire(blocking=False):
            return None
        try:
            return Sample(now, self.stage.travel(), self.gauge.tension())
        finally:
            self._in_use.release()

    def reopen(self) -> None:
        """Connect both again after one went away, unless somebody is measuring.

        Raises:
            DriverError: still not there.
        """
        if not self._in_use.acquire(blocking=False):
            return
        try:
            self.close()
            self.open()
        finally:
            self._in_use.release()

    def close(self) -> None:
        """Stop the stage and disconnect both. Never raises."""
        self.stage.close()
        self.gauge.close()
