# SPDX-License-Identifier: Apache-2.0
"""Tendon drives on a Dynamixel bus: one group read and one group write a cycle, everything slow one item at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bringup import ServoConfiguration, examine, identify, is_left_holding, set_up
from softgrip_driver.dynamixel.bus import Bus, BusReply
from softgrip_driver.dynamixel.registers import ControlItem, HardwareError
from softgrip_driver.dynamixel.restart import REBOOT_TIMEOUT, restart
from softgrip_driver.dynamixel.servo_state import ERRORS, SUPPLY, TORQUE, WATCHDOG, ServoState, SlowRead
from softgrip_driver.errors import CorruptReplyError, DriverError, NoReplyError, PortLostError
from softgrip_driver.tendon.backend import DriveIdentity, DriveReading, Setpoint
from softgrip_driver.tendon.bus_backend import BusBackend, announce
from softgrip_driver.tendon.winding import MotorReading, Winding

#: names of the fault table for the bits of the hardware error status; plain integers, for this is asked in every cycle
_FAULT_NAMES = {
    HardwareError.INPUT_VOLTAGE.value: "input_voltage",
    HardwareError.OVERHEATING.value: "overheated",
    HardwareError.MOTOR_ENCODER.value: "encoder_fault",
    HardwareError.ELECTRICAL_SHOCK.value: "electrical_shock",
    HardwareError.OVERLOAD.value: "overload",
}

#: PWM, current, velocity, position in one block: 124 .. 135
FAST_BLOCK = (reg.PRESENT_PWM.address, 12)


class DynamixelBackend(BusBackend[ServoState]):
    """Dynamixel X servos as tendon drives (TendonBackend).

    Args:
        bus: not yet open.
        servos: one for each tendon.
        watchdog: [s] of silence after which a servo stops by itself; 0 = off.
        write_eeprom: correct persistent settings that differ; otherwise they are an error.
        report: told of each of them, in words, before any of them is written.
        hold_unwatched: the watchdog runs while a servo moves only, so that a hold outlives this process.
    """

    #: [pulses] a goal must leave the one that a servo rests at to count as motion: 0.15 mm of tendon on a 10 mm spool,
    #: more than the slow correction of a hold moves it within REST_TIME
    MOTION_PULSES = 10
    #: [s] without motion before a servo counts as holding
    REST_TIME = 0.3

    #: share by which a goal current may differ from the one that is right: half of that in the tension at stall
    LIMIT_SHARE = 0.03
    #: cycles with one slow item between them where each question costs an adapter's latency
    SLOW_EVERY = 4
    #: [s] of plain sync reads after a fast one failed, and at most, where only those are answered again and again
    PLAIN_PERIOD, LONGEST_PLAIN_PERIOD = 1.0, 60.0
    #: cycles without any answer from which, and up to which, a packet that all wait for the rest of is pushed through;
    #: [s] of it in a cycle: at 1 Mbaud 250 bytes, and no packet is longer than 1 kB
    DEAF_FROM, DEAF_TO = 1, 7
    PUSH_TIME = 2.5e-3

    def __init__(
        self,
        bus: Bus,
        servos: Sequence[ServoConfiguration],
        watchdog: float = 0.08,
        *,
        write_eeprom: bool = True,
        report: Callable[[str], object] = lambda _: None,
        hold_unwatched: bool = False,
    ) -> None:
        super().__init__(bus, [ServoState(servo) for servo in servos], report)
        self.bus = bus
        self._hold_unwatched = hold_unwatched
        self._watchdog_units = (
            0 if watchdog <= 0.0 else max(1, min(127, round(watchdog / reg.WATCHDOG_SECONDS_PER_UNIT)))
        )
        self._write_eeprom = write_eeprom
        self._plain_until, self._plain_period = 0.0, self.PLAIN_PERIOD
        #: servo that was silent -> its place behind the others
        self._asked_late: dict[int, int] = {}
        self._turn = 0
        self._cycles = 0
        self._deaf = 0
        self.fast = False

    # --- connecting ------------------------------------------------------------------------------------------------

    def connect(self, *, keep_torque: bool = False) -> Sequence[DriveIdentity]:
        """Open the port, identify every servo, compare its settings, and only then set up any of them, torque off.

        With ``keep_torque`` one that holds with the settings it would be given is left as it is.
        """
        self.bus.open()
        try:
            self.allow_for_adapter()
            identities = [identify(self.bus, live.servo) for live in self._live.values()]
            self._tell_differences()
            for live, identity in zip(self._live.values(), identities, strict=True):
                if keep_torque and is_left_holding(self.bus, live.servo):
                    self._adopt(live)
                else:
                    for _ in set_up(self.bus, live.servo, write_eeprom=self._write_eeprom):
                        pass
                    self._after_set_up(live)
                live.servo = identity.servo
            self.fast = all(live.servo.fast_sync_read for live in self._live.values())
        except DriverError:
            self.bus.close()
            raise
        return [DriveIdentity(identity.servo.tendon, identity.text) for identity in identities]

    def _adopt(self, live: ServoState) -> None:
        """Learn what a servo does that was left holding, and leave it doing so.

        A bus watchdog that has tripped keeps the goals read-only until 0 is written to it (e-manual, item 98).
        """
        servo_id = live.servo.servo_id
        self._after_set_up(live)
        live.goal = live.servo.length(self.bus.read(servo_id, reg.GOAL_POSITION, attempts=3))
        self.bus.write(servo_id, reg.BUS_WATCHDOG, 0, attempts=3)
        live.powered = True

    def _tell_differences(self) -> None:
        """Report what would be written to all servos: a wrong port or ID is noticed while nothing has been."""
        servos = [live.servo for live in self._live.values()]
        differences = [one for servo in servos for one in examine(self.bus, servo) if one is not None]
        announce(differences, self._report, may_write=self._write_eeprom)

    def _let_go(self, live: ServoState) -> None:
        """Switch off; one that does not hear it is stopped by its bus watchdog."""
        self._switch_off(live, attempts=3)

    def _after_reopening(self, live: ServoState) -> None:
        live.suspect = True

    def restore(self, tendon: str) -> Iterator[None]:
        """Reboot a servo that has shut itself down and set it up again."""
        live = self._live[tendon]
        live.powered = live.mark = None
        yield from restart(self.bus, live.servo.servo_id)
        yield from self._set_up_again(live)
        live.met()
        live.alert, live.hardware_error = False, 0

    def _set_up_again(self, live: ServoState) -> Iterator[None]:
        """Set up from the beginning until every transaction was answered; patience is for the steps, not for one."""
        deadline = self.bus.clock.now_s() + REBOOT_TIMEOUT
        while True:
            try:
                for _ in set_up(self.bus, live.servo, write_eeprom=self._write_eeprom, attempts=1):
                    yield
                self._after_set_up(live, attempts=1)
            except (NoReplyError, CorruptReplyError):
                if self.bus.clock.now_s() > deadline:
                    raise
                yield
            else:
                return

    def _after_set_up(self, live: ServoState, attempts: int = 3) -> None:
        servo_id = live.servo.servo_id
        live.pwm_limit = self.bus.read(servo_id, reg.PWM_LIMIT, attempts)
        live.mark = live.servo.mark_units(self.bus.read(servo_id, live.servo.mark_item, attempts), live.pwm_limit)
        live.powered = live.armed = False
        live.limit_units = live.anchor = None
        live.goal = math.nan
        # Before the first limit is written: it depends on the voltage.
        self._take(live, SUPPLY, self.bus.read_bytes(servo_id, SUPPLY.address, SUPPLY.size, attempts).data)

    # --- a cycle ---------------------------------------------------------------------------------------------------

    def read(self) -> Mapping[str, DriveReading]:
        """Read all present servos in one transaction, one slow item, and probe one that is missing."""
        now = self.bus.clock.now_s()
        if (
            self._watchdog_units
            and now - self.bus.port.last_traffic > 0.9 * self._watchdog_units * reg.WATCHDOG_SECONDS_PER_UNIT
        ):
            for live in self._live.values():
                live.suspect = live.stalled = True
        present = self._present()
        replies = self._read_block([live.servo.servo_id for live in present], now)
        self._wake(heard=bool(replies))
        readings = {}
        answers = True  # where one that is back does not answer, the others are asked in the next cycle
        for live in present:
            reply = replies.get(live.servo.servo_id)
            if reply is None or reply.code:
                self._missed(live, now)
            elif not live.suspect or (answers and self._check_return(live)):
                readings[live.servo.tendon] = self._reading(live, reply)
            else:
                answers = False
        self._probe(now, readings)
        self._read_slowly(readings)
        return readings

    def _read_block(self, ids: Sequence[int], now: float) -> dict[int, BusReply]:
        """Read all in one answer; where nobody gives one, in an answer each, for longer every time that this helps.

        A servo that says that it has the fast read and has not would else cost a cycle each second.
        """
        if not self.fast or now < self._plain_until:
            replies = self._read_in_turn(ids)
            if not replies:  # nobody answers that either
                self._plain_period = self.PLAIN_PERIOD
            return replies
        replies = self.bus.fast_sync_read(ids, *FAST_BLOCK)
        if replies:
            self._plain_period = self.PLAIN_PERIOD
        else:
            self._plain_until = now + self._plain_period
            self._plain_period = min(2.0 * self._plain_period, self.LONGEST_PLAIN_PERIOD)
        return replies

    def _read_in_turn(self, ids: Sequence[int]) -> dict[int, BusReply]:
        """Read in an answer each. Behind one that is silent nobody answers: it is asked last from then on."""
        turns = sorted(ids, key=lambda servo_id: self._asked_late.get(servo_id, 0))
        replies = self.bus.sync_read(turns, *FAST_BLOCK)
        silent = next((servo_id for servo_id in turns if servo_id not in replies), None)
        if silent is not None:
            self._asked_late[silent] = max(self._asked_late.values(), default=0) + 1
        return replies

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Write goal positions, and before them the tension limits where they changed."""
        positions: dict[int, int] = {}
        limits: dict[ControlItem, dict[int, int]] = {reg.GOAL_CURRENT: {}, reg.GOAL_PWM: {}}
        for tendon, setpoint in setpoints.items():
            live = self._live[tendon]
            if live.absent:
                continue
            servo = live.servo
            if servo.limit_item is not None:
                units = servo.limit_units(setpoint.tension_limit, live.motor)
                if self._is_other_limit(live, units):
                    limits[servo.limit_item][servo.servo_id] = live.limit_units = units
            if setpoint.position is not None:
                positions[servo.servo_id] = servo.pulses(setpoint.position)
                self._watch_motion(live, positions[servo.servo_id])
        # The tension limit first: a raised position must never meet yesterday's higher limit.
        for item, values in limits.items():
            self.bus.sync_write(item, values)
        self.bus.sync_write(reg.GOAL_POSITION, positions)

    def _is_other_limit(self, live: ServoState, units: int) -> bool:
        """Whether a limit is worth a packet: one of the supply or the duty cycle always follows the motor's speed.

        Group writes are not acknowledged. A goal current is read back in turn; a goal PWM is not, so it is written in
        every cycle.
        """
        known = live.limit_units
        return known is None or not live.servo.has_current_goal or abs(units - known) > self.LIMIT_SHARE * known

    def _watch_motion(self, live: ServoState, goal: int) -> None:
        """Let the bus watchdog run while a servo moves; where holds are to outlive this process, only then."""
        now = self.bus.clock.now_s()
        if live.anchor is None or abs(goal - live.anchor) > self.MOTION_PULSES:
            live.anchor, live.moved_at = goal, now
        is_required = not self._hold_unwatched or now - live.moved_at < self.REST_TIME
        if is_required == live.armed or not self._watchdog_units:
            return
        try:
            self.bus.write(live.servo.servo_id, reg.BUS_WATCHDOG, self._watchdog_units if is_required else 0)
        except (NoReplyError, CorruptReplyError):
            return  # tried again in the next cycle
        live.armed = is_required

    def power(self, tendon: str, on: bool) -> None:
        """Hold the present position, or let go."""
        live = self._live[tendon]
        # Unknown until it has been read, however far this gets: what was known before must not pass for a restart.
        live.powered = None
        if not on:
            self._switch_off(live, attempts=2)
            return
        servo_id = live.servo.servo_id
        position = self.bus.read(servo_id, reg.PRESENT_POSITION, attempts=2)
        self.bus.write(servo_id, reg.BUS_WATCHDOG, 0, attempts=2)
        self.bus.write(servo_id, reg.TORQUE_ENABLE, 1, attempts=2)
        # Written with torque on: some firmware copies the present position at that moment, and the last word is ours.
        self.bus.write(servo_id, reg.GOAL_POSITION, position, attempts=2)
        self.bus.write(servo_id, reg.BUS_WATCHDOG, self._watchdog_units, attempts=2)
        live.limit_units = live.anchor = None
        live.armed = True

    def motor(self, tendon: str) -> MotorReading:
        """Return what the last reading showed of a servo's motor."""
        return self._live[tendon].motor

    def winding(self, tendon: str) -> Winding:
        """Return resistance and back-EMF of a servo's motor."""
        return self._live[tendon].servo.motor

    def goal_current(self, tendon: str) -> float:
        """Return the goal current [A] that was written last; NaN where none was."""
        live = self._live[tendon]
        return math.nan if live.limit_units is None else live.limit_units * live.servo.model.ampere_per_unit

    def mark_session(self, tendon: str, mark: int) -> None:
        """Keep the mark in the servo's `mark_item`, where a restart puts it back."""
        live = self._live[tendon]
        servo = live.servo
        self.bus.write(servo.servo_id, servo.mark_item, servo.mark_units(mark, live.pwm_limit), attempts=2)
        live.mark = mark

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _wake(self, *, heard: bool) -> None:
        """Help servos that are all deaf at once: a length that lost a byte lets them wait for half a kilobyte."""
        self._deaf = 0 if heard else self._deaf + 1
        if self.DEAF_FROM <= self._deaf < self.DEAF_TO:
            self.bus.push_through(self.PUSH_TIME)

    def _switch_off(self, live: ServoState, attempts: int) -> None:
        servo_id = live.servo.servo_id
        self.bus.write(servo_id, reg.TORQUE_ENABLE, 0, attempts=attempts)
        self.bus.write(servo_id, reg.BUS_WATCHDOG, 0, attempts=attempts)
        live.powered = live.armed = False

    def _reading(self, live: ServoState, reply: BusReply) -> DriveReading:
        live.met()
        if reply.alert != live.alert:
            live.alert = reply.alert
            live.urgent = [ERRORS, TORQUE]
        servo = live.servo
        live.motor = servo.motor_reading(
            reply.data,
            live.values.get("voltage", live.motor.voltage),
            live.values.get("temperature", live.motor.temperature),
        )
        position = servo.length(reg.PRESENT_POSITION.decode(reply.data[8:12]))
        velocity = live.motor.speed * servo.spool.radius
        now = self.bus.clock.now_s()
        if servo.shows_warmth:
            live.warmth.observe(servo.motor, live.motor, now)
        current, pull, stddev = servo.pull(live.motor, live.warmth)
        faults = tuple(name for bit, name in _FAULT_NAMES.items() if live.hardware_error & bit)
        if live.watchdog_tripped:
            faults += ("bus_watchdog",)
            live.watchdog_tripped = False
        # A servo that is in error has a reason for being without torque; until it is known, nobody says "restarted".
        powered = None if live.alert and not live.hardware_error else live.powered
        return DriveReading(
            now, position, velocity, max(0.0, pull), stddev, pull, current,
            live.values.get("temperature", math.nan), live.values.get("voltage", math.nan),
            powered, live.mark, faults, "", live.hardware_error, abs(current) / servo.model.stall_current,
        )  # fmt: skip

    def _missed(self, live: ServoState, now: float) -> None:
        live.missed(now)
        # It may stand by now: a limit for a motor that turns would let it pull too hard.
        live.motor = replace(live.motor, speed=0.0)
        live.suspect = live.suspect or live.absent

    def _ask(self, live: ServoState) -> DriveReading | None:
        reply = self.bus.read_bytes(live.servo.servo_id, *FAST_BLOCK)
        live.met()
        return self._reading(live, reply) if self._check_return(live) else None

    def _check_return(self, live: ServoState) -> bool:
        """Look what became of a servo that was away, before anybody commands it again; return whether that is known.

        It may have restarted, or stopped itself by its bus watchdog. The latter is a fault of its own where this side
        was silent; where the servo was, that has been told.
        """
        if not live.suspect:
            return True
        try:
            for block in (live.mark_block, TORQUE, WATCHDOG, ERRORS):
                self._take(live, block, self.bus.read_bytes(live.servo.servo_id, block.address, block.size).data)
        except PortLostError:
            raise
        except DriverError:
            return False
        live.watchdog_tripped = live.watchdog_tripped and live.stalled
        live.suspect = live.stalled = False
        return True

    def _read_slowly(self, readings: Mapping[str, DriveReading]) -> None:
        """Read one block of one servo: an urgent one first, else the next in turn."""
        answering = [live for live in self._live.values() if live.servo.tendon in readings]
        if not answering:
            return
        self._cycles += 1
        urgent = next((live for live in answering if live.urgent), None)
        if urgent is not None:
            live, block = urgent, urgent.urgent.pop(0)
        elif self._is_slow and self._cycles % self.SLOW_EVERY:
            return
        else:
            self._turn += 1
            live = answering[self._turn % len(answering)]
            block = live.round[self._turn // len(answering) % len(live.round)]
        try:
            data = self.bus.read_bytes(live.servo.servo_id, block.address, block.size).data
        except PortLostError:
            raise
        except DriverError:
            # Counted by the bus; the group read tells whether the servo is gone.
            return
        self._take(live, block, data)

    def _take(self, live: ServoState, block: SlowRead, data: bytes) -> None:
        def value(item: ControlItem) -> int:
            start = item.address - block.address
            return item.decode(data[start : start + item.size])

        if block is TORQUE:
            live.powered = bool(value(reg.TORQUE_ENABLE))
        elif block is ERRORS:
            live.hardware_error = value(reg.HARDWARE_ERROR)
        elif block is SUPPLY:
            live.values["voltage"] = value(reg.PRESENT_VOLTAGE) * reg.VOLT_PER_UNIT
            live.values["temperature"] = float(value(reg.PRESENT_TEMPERATURE))
        elif block is live.mark_block:
            live.mark = live.servo.mark_units(value(live.servo.mark_item), live.pwm_limit)
            if live.servo.has_current_goal and value(reg.GOAL_CURRENT) != live.limit_units:
                # Group writes are not acknowledged; this one was lost, so it is sent again.
                live.limit_units = None
        elif block is WATCHDOG and value(reg.BUS_WATCHDOG) == -1:
            live.watchdog_tripped = True
            self.bus.write(live.servo.servo_id, reg.BUS_WATCHDOG, 0, attempts=2)
            self.bus.write(live.servo.servo_id, reg.BUS_WATCHDOG, self._watchdog_units, attempts=2)
            live.limit_units, live.armed = None, True
