# SPDX-License-Identifier: Apache-2.0
"""One tendon on a linear stage (GRBL) or a test stand, with a force gauge in the line where there is one.

A stage moves to a target by itself and is asked and told over text lines, so the loop runs at 10 Hz or less; the
tension limit is the controller's alone, and without a gauge there is none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence

from softgrip_driver.errors import CorruptReplyError, DriverError, NoReplyError, PortLostError, RefusedError
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.tendon.backend import DriveIdentity, DriveReading, Setpoint


class StageBackend:
    """A stage as a tendon drive (TendonBackend).

    Args:
        tendon: name of the tendon.
        stage: not yet open; pulls with growing travel.
        gauge: not yet open, or None.
        speed: [m/s] towards a setpoint.
    """

    #: [m] a setpoint must move before the stage is told
    STEP = 5e-5
    #: [N] uncertainty of a gauge's reading
    GAUGE_STDDEV = 0.02

    def __init__(self, tendon: str, stage: Stage, gauge: Gauge | None, speed: float) -> None:
        self._tendon = tendon
        self._stage = stage
        self._gauge = gauge
        self._speed = speed
        self._powered = False
        self._mark = 0
        self._target: float | None = None
        self._before: tuple[float, float] | None = None
        self._fault = ""

    @property
    def tendons(self) -> Sequence[str]:
        """The one tendon."""
        return (self._tendon,)

    def connect(self) -> Sequence[DriveIdentity]:
        """Open stage and gauge; nothing moves."""
        identity = self._stage.open()
        try:
            if self._gauge is not None:
                self._gauge.open()
        except DriverError:
            self._stage.close()
            raise
        self._mark, self._powered, self._target = 0, False, None
        return (DriveIdentity(self._tendon, f"{identity.model} {identity.serial}".strip(), identity.warnings),)

    def disconnect(self) -> None:
        """Stop and close."""
        self._stage.close()
        if self._gauge is not None:
            self._gauge.close()

    def reconnect(self) -> bool:
        """Open again; the position may be another one, so the session mark is gone."""
        self.disconnect()
        try:
            self.connect()
        except DriverError:
            return False
        return True

    def restore(self, tendon: str) -> Iterator[None]:
        """Open again, as a stage knows no other way back from an alarm."""
        del tendon
        yield
        self.disconnect()
        yield
        self.connect()

    def read(self) -> Mapping[str, DriveReading]:
        """Ask where the stage is and how much the gauge feels."""
        try:
            position = self._stage.travel()
            tension = math.nan if self._gauge is None else self._gauge.tension()
        except (NoReplyError, CorruptReplyError):
            return {}
        now = time.monotonic()
        before = self._before
        velocity = 0.0 if before is None or now <= before[0] else (position - before[1]) / (now - before[0])
        self._before = (now, position)
        pull = 0.0 if math.isnan(tension) else tension
        stddev = math.nan if math.isnan(tension) else self.GAUGE_STDDEV
        faults = (self._fault,) if self._fault else ()
        self._fault = ""
        return {
            self._tendon: DriveReading(
                now, position, velocity, max(0.0, pull), stddev, pull,
                powered=self._powered, session_mark=self._mark, faults=faults,
            )
        }  # fmt: skip

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Send the stage to where the setpoint is."""
        setpoint = setpoints.get(self._tendon)
        if setpoint is None or setpoint.position is None or not self._powered:
            return
        if self._target is not None and abs(setpoint.position - self._target) < self.STEP:
            return
        try:
            self._stage.start(setpoint.position, self._speed)
            self._target = setpoint.position
        except RefusedError:
            # Limit switch, alarm, shield open: the position may be lost, and only opening it again tells.
            self._fault = "stalled"
        except (NoReplyError, CorruptReplyError):
            # The next cycle tells it again.
            self._target = None

    def power(self, tendon: str, on: bool) -> None:
        """Hold, which a stage does by its screw; letting go means to stop, as it cannot be turned by the tendon."""
        del tendon
        self._target = None
        self._powered = on
        try:
            self._stage.stop()
        except PortLostError:
            if on:
                raise

    def mark_session(self, tendon: str, mark: int) -> None:
        """Keep the mark as long as the connection: a stage has no volatile memory to put it in."""
        del tendon
        self._mark = mark
