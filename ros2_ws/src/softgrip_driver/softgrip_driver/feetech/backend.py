# SPDX-License-Identifier: Apache-2.0
"""Tendon drives on a bus of Feetech STS servos: one group read a cycle tells everything of every servo."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from softgrip_driver.errors import CorruptReplyError, DriverError, NoReplyError
from softgrip_driver.feetech import registers as reg
from softgrip_driver.feetech.bringup import examine, identify, is_left_holding, set_up
from softgrip_driver.feetech.bus import FeetechBus
from softgrip_driver.feetech.packets import FeetechAnswer
from softgrip_driver.feetech.registers import FeetechStatusBits
from softgrip_driver.feetech.servo import FeetechServo, value_in
from softgrip_driver.tendon.backend import DriveIdentity, DriveReading, Setpoint
from softgrip_driver.tendon.bus_backend import BusBackend, BusDevice, announce
from softgrip_driver.tendon.profile import GoalSpeed
from softgrip_driver.tendon.winding import MotorReading

#: names of the fault table for the bits of the servo status
_FAULT_NAMES = {
    FeetechStatusBits.VOLTAGE: "input_voltage",
    FeetechStatusBits.ENCODER: "encoder_fault",
    FeetechStatusBits.TEMPERATURE: "overheated",
    FeetechStatusBits.CURRENT: "overload",
    FeetechStatusBits.OVERLOAD: "overload",
}
NO_WATCHDOG = "it has no bus watchdog: where this computer falls silent it goes on to its last goal and holds there"
#: [s] for a servo to answer again after its turns were reset
RESTORE_TIMEOUT_S = 4.0


@dataclass
class _Live(BusDevice):
    """What is known of a servo while the loop runs."""

    servo: FeetechServo
    limit_units: int | None = None
    speed_units: int = 0
    motor: MotorReading = field(init=False)
    goal_speed: GoalSpeed = field(init=False)

    def __post_init__(self) -> None:
        self.motor = self.servo.standing()
        self.goal_speed = GoalSpeed(self.servo.own_speed)

    @property
    def tendon(self) -> str:
        """Name of the tendon on its spool."""
        return self.servo.tendon

    @property
    def device_id(self) -> int:
        """ID that the bus knows it by."""
        return self.servo.servo_id


class FeetechBackend(BusBackend[_Live]):
    """Feetech STS servos as tendon drives (TendonBackend).

    Args:
        bus: not yet open.
        servos: one for each tendon.
        write_eeprom: correct persistent settings that differ; otherwise they are an error.
        report: told of each of them, in words, before any of them is written.
    """

    #: share by which a torque limit may differ from the one that is right
    LIMIT_SHARE = 0.03
    #: share by which the servo's own speed may differ from the one that is right
    SPEED_SHARE = 0.1

    def __init__(
        self,
        bus: FeetechBus,
        servos: Sequence[FeetechServo],
        *,
        write_eeprom: bool = True,
        report: Callable[[str], object] = lambda _: None,
    ) -> None:
        super().__init__(bus, [_Live(servo) for servo in servos], report)
        self.bus = bus
        self._write_eeprom = write_eeprom

    # --- connecting ------------------------------------------------------------------------------------------------

    def connect(self, *, keep_torque: bool = False) -> Sequence[DriveIdentity]:
        """Open the port, identify every servo, compare its settings, and only then set up any of them, torque off."""
        self.bus.open()
        try:
            self.allow_for_adapter()
            texts = {}
            for live in self._live.values():
                live.servo, texts[live.servo.tendon] = identify(self.bus, live.servo)
            self._tell_differences()
            for live in self._live.values():
                if keep_torque and is_left_holding(self.bus, live.servo):
                    self._after_set_up(live)
                    live.powered = True
                    live.goal = live.servo.length(self.bus.get(live.servo.servo_id, reg.GOAL_POSITION, 3))
                else:
                    for _ in set_up(self.bus, live.servo, write_eeprom=self._write_eeprom):
                        pass
                    self._after_set_up(live)
        except DriverError:
            self.bus.close()
            raise
        return [DriveIdentity(tendon, text, (NO_WATCHDOG,)) for tendon, text in texts.items()]

    def _tell_differences(self) -> None:
        servos = [live.servo for live in self._live.values()]
        differences = [one for servo in servos for one in examine(self.bus, servo) if one is not None]
        announce(differences, self._report, may_write=self._write_eeprom)

    def _after_set_up(self, live: _Live) -> None:
        live.met()
        live.limit_units = None
        live.powered, live.goal, live.mark = False, math.nan, None
        live.goal_speed.restart()
        live.speed_units = live.servo.speed_units(live.servo.own_speed)
        live.motor = live.servo.standing()

    def _let_go(self, live: _Live) -> None:
        self.bus.put(live.servo.servo_id, reg.TORQUE_ENABLE, 0, 3)

    def _after_reopening(self, live: _Live) -> None:
        live.limit_units = None

    def restore(self, tendon: str) -> Iterator[None]:
        """Let a servo forget its turns and its overload, and set it up again."""
        live = self._live[tendon]
        live.powered = live.mark = None
        deadline = self.bus.clock.now_s() + RESTORE_TIMEOUT_S
        while True:
            try:
                self.bus.reset_turns(live.servo.servo_id)
                yield
                self.bus.put(live.servo.servo_id, reg.OPEN_LOOP_SPEED, 0)
                for _ in set_up(self.bus, live.servo, write_eeprom=self._write_eeprom, attempts=1):
                    yield
            except (NoReplyError, CorruptReplyError):
                if self.bus.clock.now_s() > deadline:
                    raise
                yield
            else:
                break
        self._after_set_up(live)

    # --- a cycle ---------------------------------------------------------------------------------------------------

    def read(self) -> Mapping[str, DriveReading]:
        """Read all present servos in one transaction, and probe one that is missing."""
        now = self.bus.clock.now_s()
        present = self._present()
        answers = self.bus.sync_read([live.servo.servo_id for live in present], *reg.CYCLE_BLOCK)
        readings = {}
        for live in present:
            answer = answers.get(live.servo.servo_id)
            if answer is None:
                self._missed(live, now)
            else:
                readings[live.servo.tendon] = self._reading(live, answer)
        self._probe(now, readings)
        return readings

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Write torque limits where they changed, then goal positions.

        A servo without torque gets none: a goal would switch it on.
        """
        positions: dict[int, int] = {}
        limits: dict[int, int] = {}
        speeds: dict[int, int] = {}
        now = self.bus.clock.now_s()
        for tendon, setpoint in setpoints.items():
            live = self._live[tendon]
            if live.absent or not live.powered:
                continue
            servo = live.servo
            units = servo.duty_units(setpoint.tension_limit, live.motor)
            known = live.limit_units
            if known is None or abs(units - known) > self.LIMIT_SHARE * known:
                limits[servo.servo_id] = live.limit_units = units
            if setpoint.position is not None:
                positions[servo.servo_id] = steps = servo.steps(setpoint.position)
                speed = servo.speed_units(live.goal_speed.update(now, steps * reg.RAD_PER_STEP))
                if abs(speed - live.speed_units) > self.SPEED_SHARE * live.speed_units:
                    speeds[servo.servo_id] = live.speed_units = speed
        # The tension limit first: a raised position must never meet yesterday's higher limit.
        self.bus.sync_write(reg.TORQUE_LIMIT, limits)
        self.bus.sync_write(reg.GOAL_SPEED, speeds)
        self.bus.sync_write(reg.GOAL_POSITION, positions)

    def power(self, tendon: str, on: bool) -> None:
        """Hold the present position, or let go."""
        live = self._live[tendon]
        servo_id = live.servo.servo_id
        # Unknown until it has been read, however far this gets.
        live.powered = None
        if on:
            # The goal first: it stands where the one before was, and torque would drive there.
            position = self.bus.get(servo_id, reg.PRESENT_POSITION, 2)
            self.bus.put(servo_id, reg.GOAL_POSITION, position, 2)
            live.limit_units = None
            live.goal_speed.restart()
        self.bus.put(servo_id, reg.TORQUE_ENABLE, int(on), 2)

    def mark_session(self, tendon: str, mark: int) -> None:
        """Keep the mark in the open-loop mode's speed, which no other mode looks at."""
        live = self._live[tendon]
        self.bus.put(live.servo.servo_id, reg.OPEN_LOOP_SPEED, mark, 2)
        live.mark = mark

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _reading(self, live: _Live, answer: FeetechAnswer) -> DriveReading:
        live.met()
        servo, block = live.servo, answer.data
        live.motor = servo.motor_reading(block)
        live.powered = value_in(block, reg.TORQUE_ENABLE) == 1
        mark = value_in(block, reg.OPEN_LOOP_SPEED)
        live.mark = mark if mark < reg.MARK_END else 0
        if live.limit_units is not None and value_in(block, reg.TORQUE_LIMIT) != live.limit_units:
            # Group writes are not acknowledged; this one was lost, so it is sent again.
            live.limit_units = None
        status = value_in(block, reg.STATUS)
        current, pull, stddev = servo.pull(live.motor)
        faults = tuple(dict.fromkeys(name for bit, name in _FAULT_NAMES.items() if status & bit))
        return DriveReading(
            self.bus.clock.now_s(), servo.length(value_in(block, reg.PRESENT_POSITION)),
            live.motor.speed * servo.spool.radius, max(0.0, pull), stddev, pull, current, live.motor.temperature,
            live.motor.voltage, live.powered, live.mark, faults, "", status,
        )  # fmt: skip

    def _missed(self, live: _Live, now: float) -> None:
        live.missed(now)
        # It may stand by now: a limit for a motor that turns would let it pull too hard.
        live.motor = replace(live.motor, speed=0.0)

    def _ask(self, live: _Live) -> DriveReading | None:
        return self._reading(live, self.bus.read(live.servo.servo_id, *reg.CYCLE_BLOCK))
