# SPDX-License-Identifier: Apache-2.0
"""Stage and gauge together: opened as one, used by one at a time, stopped on every way out."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from softgrip_driver.errors import DeviceNotFoundError, DriverError, NoReplyError, PortLostError
from softgrip_driver.rig.devices import DeviceIdentity, Gauge, Stage
from softgrip_driver.rig.pull import RigSample

#: [s] between attempts to connect.
_RETRY_PERIOD = 0.1
#: [s] for devices that went away to come back when a measurement begins.
_OPEN_TIMEOUT_S = 3.0


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
        self._measuring = threading.Lock()
        self._in_use = threading.Lock()
        self._closed = threading.Event()
        self._connected = False

    def open(self, timeout: float = 0.0) -> tuple[DeviceIdentity, DeviceIdentity]:
        """Connect and identify both.

        Args:
            timeout: [s] to keep trying while a device is not there yet.

        Raises:
            DriverError: of whichever is not there; the other one is closed again.
        """
        self._closed.clear()
        end = time.monotonic() + timeout
        while True:
            try:
                identities = self.stage.open(), self.gauge.open()
            except (DeviceNotFoundError, PortLostError, NoReplyError):
                self._disconnect()
                if time.monotonic() >= end or self._closed.wait(_RETRY_PERIOD):
                    raise
            except DriverError:
                self._disconnect()
                raise
            else:
                self._connected = True
                return identities

    @contextmanager
    def measuring(self) -> Iterator[None]:
        """Reserve the devices.

        Raises:
            BusyError: somebody has.
            DriverError: a device is not there.
        """
        if not self._measuring.acquire(blocking=False):
            raise BusyError("the rig is measuring already: wait for it, or cancel it first")
        try:
            # A look of the idle rig is over soon; it is no measurement that could be cancelled.
            with self._in_use:
                if not self._connected:  # a device was silent when somebody looked
                    self.open(_OPEN_TIMEOUT_S)
                yield
        finally:
            self._measuring.release()

    def read_idle(self, now: float) -> RigSample | None:
        """Read both while nobody measures; None while somebody does.

        Raises:
            DriverError: a device does not answer as it should.
        """
        if not self._in_use.acquire(blocking=False):
            return None
        try:
            return RigSample(now, self.stage.travel(), self.gauge.tension())
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
            self._disconnect()
            self.open()
        finally:
            self._in_use.release()

    def close(self) -> None:
        """Stop the stage and disconnect both, also while somebody waits in `open`. Never raises."""
        self._closed.set()
        self._disconnect()

    def _disconnect(self) -> None:
        self._connected = False
        self.stage.close()
        self.gauge.close()
