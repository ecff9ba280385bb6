# SPDX-License-Identifier: Apache-2.0
"""One tendon on a linear stage (GRBL) or a test stand, with a force gauge in its line.

A stage moves to a target by itself and is asked and told over text lines, so the loop runs at some 10 Hz. It has no
current limit: this backend stops it where the gauge reads the tension limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from softgrip_driver.errors import (
    CorruptReplyError,
    DeviceRefusedError,
    DriverError,
    GaugeRestartedError,
    NoReplyError,
    NotReadyError,
    PortLostError,
    SaturatedError,
    UnitChangedError,
)
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.stage.gauge_guard import MAX_NEGATIVE_N, GaugeGuard
from softgrip_driver.tendon.backend import Counters, DriveIdentity, DriveReading, Setpoint
from softgrip_time import Clock, WallClock

Value = TypeVar("Value")


class StageBackend:
    """A stage as a tendon drive (TendonBackend).

    Args:
        tendon: name of the tendon.
        stage: not yet open; pulls with growing travel.
        gauge: not yet open.
        speed: [m/s] towards a setpoint.
        proof: [N] that a hand must pull before anything is wound in (`GaugeGuard`); 0 = none.
        clock: of the readings; the computer's where none is given.
    """

    #: [m] a setpoint must move before the stage is told
    STEP = 5e-5
    #: [N] uncertainty of a gauge's reading
    GAUGE_STDDEV = 0.02
    #: readings of the gauge in a row that may fail before its silence is a fault: one line may be damaged
    GAUGE_MISSES = 2
    #: [m] of travel and [N] of tension over which no real gauge shows the same digits
    STUCK_TRAVEL, STUCK_TENSION = 2e-3, 0.1

    def __init__(
        self, tendon: str, stage: Stage, gauge: Gauge, speed: float, proof: float = 0.0, clock: Clock | None = None
    ) -> None:
        self._clock = clock or WallClock()
        self._tendon = tendon
        self._stage = stage
        self._gauge = gauge
        self._speed = speed
        self._proof = proof
        self._guard = GaugeGuard(proof)
        self._counters = Counters()
        self._powered = False
        self._mark = 0
        self._target: float | None = None
        self._before: tuple[float, float] | None = None
        self._pull = 0.0
        self._gauge_misses = 0
        self._gauge_fault = ("", "")
        #: what it said when it restarted; told with the next reading, whether the tendon is held or not
        self._restarted = ""
        self._same_since = 0.0
        #: name in the fault table, and what the device said; told with the next reading
        self._fault = ("", "")

    @property
    def tendons(self) -> Sequence[str]:
        """The one tendon."""
        return (self._tendon,)

    @property
    def counters(self) -> Counters:
        """What both ports have seen."""
        return self._counters

    # --- connecting ------------------------------------------------------------------------------------------------

    def connect(self, *, keep_torque: bool = False) -> Sequence[DriveIdentity]:
        """Open stage and gauge; nothing moves. A stage whose controller boots when its port is opened takes seconds.

        A stage holds by its screw whatever ``keep_torque`` says, and has no goal to take over.
        """
        del keep_torque
        stage = self._stage.open()
        try:
            gauge = self._gauge.open()
        except DriverError:
            self._stage.close()
            raise
        self._forget()
        self._guard = GaugeGuard(self._proof)
        device = f"{stage.model} {stage.serial}".strip() + f" with {gauge.model}"
        return (DriveIdentity(self._tendon, device, (*stage.warnings, *gauge.warnings)),)

    def is_powered(self, tendon: str) -> bool:
        """Return False: there is nothing to take over."""
        del tendon
        return False

    def goal_position(self, tendon: str) -> float:
        """Return NaN: there is nothing to take over."""
        del tendon
        return math.nan

    def disconnect(self, *, keep_torque: bool = False) -> None:
        """Stop and close; its screw holds whatever ``keep_torque`` says."""
        del keep_torque
        self._stage.close()
        self._gauge.close()

    def reconnect(self) -> bool:
        """Open again; the position may be another one, so the session mark is gone."""
        self.disconnect()
        try:
            self.connect()
        except DriverError:
            return False
        self._counters.reopened += 1
        return True

    def restore(self, tendon: str) -> Iterator[None]:
        """Leave an alarm, at a person's word; the zero is gone. Opening again would lock one with switches again."""
        del tendon
        yield
        self._stage.unlock()
        self._forget()

    # --- a cycle ---------------------------------------------------------------------------------------------------

    def read(self) -> Mapping[str, DriveReading]:
        """Ask where the stage is and how much the gauge feels."""
        try:
            position = self._asked(self._stage.travel)
            fault, detail = self._fault
        except (NoReplyError, CorruptReplyError):
            return {}
        except DeviceRefusedError as error:
            if self._before is None:
                return {}
            # It does not know any more where it is; what it knew last stands in the reading, with the fault.
            position, fault, detail = self._before[1], "stage_alarm", str(error)
        self._fault = ("", "")
        self._read_gauge(position)
        if self._restarted and not fault:
            fault, detail = "gauge_restarted", self._restarted
            self._restarted = ""
        if self._gauge_misses > self.GAUGE_MISSES and self._powered and not fault:
            fault, detail = self._gauge_fault
            self._halt()
        if not fault:
            fault, detail = self._guard.fault
        now = self._clock.now_s()
        before = self._before
        velocity = 0.0 if before is None or now <= before[0] else (position - before[1]) / (now - before[0])
        self._before = (now, position)
        return {
            self._tendon: DriveReading(
                now, position, velocity, max(0.0, self._pull), self.GAUGE_STDDEV, self._pull, powered=self._powered,
                session_mark=self._mark, faults=(fault,) if fault else (), fault_detail=detail, is_gauged=True,
            )
        }  # fmt: skip

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Send the stage to where the setpoint is, or stop it at the tension limit."""
        setpoint = setpoints.get(self._tendon)
        if setpoint is None or not self._powered or self._before is None:
            return
        if setpoint.position is None:
            if self._target is not None:
                self._halt()
            return
        here, goal = self._before[1], setpoint.position
        if self._gauge_misses or (self._pull >= setpoint.tension_limit and goal > here):
            # Pulling blind, or beyond the limit; letting out goes on once the gauge can be read.
            self._halt()
            return
        # One reading below nothing may be a damaged one and is no fault yet; nothing is wound in by it either.
        if goal > here and (self._guard.fault[0] or self._pull < -MAX_NEGATIVE_N):
            self._halt()
            return
        if self._target is not None and abs(goal - self._target) < self.STEP:
            return
        try:
            if self._target is not None and (goal - here) * (self._target - here) < 0.0:
                # A stage with a queue would first go to where it was sent before.
                self._stage.stop()
            self._asked(lambda: self._stage.start(goal, self._speed))
            self._target = goal
        except (NoReplyError, CorruptReplyError, NotReadyError):
            # The next cycle tells it again.
            self._target = None
        except DeviceRefusedError as error:
            self._target = None
            self._fault = ("stage_refused", str(error))

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
        """Keep the mark as long as the connection: a stage has no volatile memory to put it in.

        Without a zero the next motion is a homing, which must not rely on a cell that may be cut.
        """
        del tendon
        self._mark = mark
        if mark == 0:
            self._guard.doubt()

    def _forget(self) -> None:
        """Take nothing of the session before for true: neither its zero nor its power."""
        self._mark, self._powered, self._target, self._before = 0, False, None, None
        self._gauge_misses, self._fault, self._restarted = 0, ("", ""), ""

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _read_gauge(self, position: float) -> None:
        try:
            pull = self._asked(self._gauge.tension)
            if pull != self._pull:
                self._pull, self._same_since = pull, position
            elif abs(pull) > self.STUCK_TENSION and abs(position - self._same_since) > self.STUCK_TRAVEL:
                raise CorruptReplyError(
                    f"gauge: expected a tension that changes, found {pull:.2f} N over "
                    f"{abs(position - self._same_since) * 1e3:.1f} mm: it is stuck; restart it"
                )
            self._gauge_misses = 0
            self._guard.observe(pull, position)
        except PortLostError:
            self._halt()
            raise
        except SaturatedError as error:
            # More than it can tell is more than any limit.
            self._gauge_misses, self._gauge_fault = self.GAUGE_MISSES + 1, ("tension_exceeded", str(error))
        except GaugeRestartedError as error:
            self._gauge_misses, self._restarted = self._gauge_misses + 1, str(error)
        except (NoReplyError, CorruptReplyError, DeviceRefusedError, UnitChangedError) as error:
            self._gauge_misses, self._gauge_fault = self._gauge_misses + 1, ("gauge_lost", str(error))

    def _halt(self) -> None:
        self._stage.stop()
        self._target = None

    def _asked(self, question: Callable[[], Value]) -> Value:
        counters = self._counters
        counters.transactions += 1
        try:
            return question()
        except NoReplyError:
            counters.lost += 1
            raise
        except CorruptReplyError:
            counters.corrupt += 1
            raise
        except DeviceRefusedError:
            counters.refused += 1
            raise
