# SPDX-License-Identifier: Apache-2.0
"""Tendon drives of Damiao motors: position with a limit of the current, one question a cycle for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from softgrip_driver.damiao import frames
from softgrip_driver.damiao.bus import DamiaoBus
from softgrip_driver.damiao.frames import DamiaoModel, DamiaoState, Feedback, Register
from softgrip_driver.damiao.slcan import Frame
from softgrip_driver.errors import (
    MISSING_SERVO_REMEDY,
    ConfigurationError,
    DeviceNotFoundError,
    DriverError,
    NoReplyError,
    PortLostError,
    WrongDeviceError,
)
from softgrip_driver.tendon.backend import DriveIdentity, DriveReading, Setpoint
from softgrip_driver.tendon.bus_backend import BusBackend, BusDevice
from softgrip_driver.tendon.profile import GoalSpeed
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.usb_adapter import LATENCY_REMEDY, SLOW_ADAPTER_S, latency_timer

#: names of the fault table for what a motor says of itself
_FAULT_NAMES: dict[int, str] = {
    DamiaoState.OVER_VOLTAGE: "input_voltage",
    DamiaoState.UNDER_VOLTAGE: "input_voltage",
    DamiaoState.OVER_CURRENT: "overload",
    DamiaoState.BOARD_TOO_WARM: "overheated",
    DamiaoState.ROTOR_TOO_WARM: "overheated",
    DamiaoState.LOST_COMMUNICATION: "bus_watchdog",
    DamiaoState.OVERLOAD: "overload",
}
NO_WATCHDOG = (
    "its time-out is off, since it would let go of what it holds: where this computer falls silent it goes on to its "
    "last goal and holds there; unclean_end_policy let_go switches it on"
)
ATTEMPTS = 4
#: [degC] that a session mark takes off the over-temperature limit, which a restart puts back
DEGC_PER_MARK = 0.02
#: [rad/s] asked of a motor at least: where its speed loop has no integral (KI_ASR 0), it pulls by what the speed lacks,
#: and would hardly hold with less
SLOWEST_RAD_S = 1.2
#: [s] for a motor to answer again
RESTORE_TIMEOUT_S = 4.0


@dataclass(frozen=True)
class DamiaoMotor:
    """One motor of the configuration.

    Attributes:
        tendon: name of the tendon on its spool.
        motor_id: 1 .. 15.
        speed: [m/s] the motor's own limit is twice that of the setpoint.
        tension_hard: [N] no limit is ever a tenth above it.
    """

    tendon: str
    motor_id: int
    model: DamiaoModel
    spool: Spool
    torque: TorqueModel
    speed: float
    tension_hard: float

    @property
    def own_speed(self) -> float:
        """The motor's own speed limit [rad/s]."""
        return 2.0 * self.speed / self.spool.radius

    def angle(self, length: float) -> float:
        """Return the position [rad] at a length [m], within what the feedback can tell."""
        limit = self.model.ranges.position
        return max(-limit, min(limit, self.spool.angle(length)))

    def current(self, tension: float) -> float:
        """Return the largest current [A] for a tension limit [N]."""
        return self.torque.current(min(tension, 1.1 * self.tension_hard), self.spool.radius)

    def pull(self, seen: Feedback) -> tuple[float, float, float]:
        """Return the current [A], and the force [N] on the tendon with its standard deviation [N]."""
        model, radius = self.model, self.spool.radius
        current = self.spool.direction * seen.torque / model.torque_per_ampere
        stddev = model.ranges.torque_step / math.sqrt(12.0) / model.torque_per_ampere
        return current, *self.torque.pull(current, self.spool.length(seen.speed), radius, stddev)


@dataclass
class _Live(BusDevice):
    """What is known of a motor while the loop runs.

    Attributes (those that do not speak for themselves):
        order: that it has, while its torque is on.
    """

    motor: DamiaoMotor
    order: Frame | None = None
    target: float = math.nan
    max_current: float = math.nan
    voltage: float = math.nan
    goal_speed: GoalSpeed = field(init=False)

    def __post_init__(self) -> None:
        self.goal_speed = GoalSpeed(self.motor.own_speed, SLOWEST_RAD_S)

    @property
    def tendon(self) -> str:
        """Name of the tendon on its spool."""
        return self.motor.tendon

    @property
    def device_id(self) -> int:
        """ID that the bus knows it by."""
        return self.motor.motor_id


class DamiaoBackend(BusBackend[_Live]):
    """Damiao motors as tendon drives (TendonBackend).

    Args:
        bus: not yet open.
        motors: one for each tendon.
        timeout: [s] of silence after which a motor lets go by itself; 0 = off.
        report: told in words what is about to be changed in a motor.
    """

    SLOW_LOOP_COST = ", and with less than the loop_rate that its motors need their jerks pass for tension"
    #: cycles between two slow questions
    SLOW_EVERY = 5
    #: share of the period between two goals for which the last one's jerk shows in a motor's torque, and how long that
    #: period may be, in those that a model needs: with longer ones a motor rests before each goal, and rest tells less
    JERK_SHARE, LONGEST_SHARE = 0.4, 1.1

    def __init__(
        self,
        bus: DamiaoBus,
        motors: Sequence[DamiaoMotor],
        timeout: float,
        report: Callable[[str], object] = lambda _: None,
    ) -> None:
        super().__init__(bus, [_Live(motor) for motor in motors], report)
        self.bus = bus
        self._timeout = timeout
        self._cycles = 0
        #: [s] when goals were sent last, and the period between those and the ones before
        self._ordered_at, self._order_period = -math.inf, math.inf

    # --- connecting ------------------------------------------------------------------------------------------------

    def allow_for_adapter(self) -> None:
        """See `BusBackend`; an adapter whose own timer keeps bytes back for good is refused.

        Raises:
            ConfigurationError: it lets no more goals through than make a motor's jerks pass for tension.
        """
        super().allow_for_adapter()
        timer = latency_timer(self.bus.port_name)
        if self._is_slow and timer is not None and timer > SLOW_ADAPTER_S:
            model = next(iter(self._live.values())).motor.model
            raise ConfigurationError(
                f"port {self.bus.port_name}: expected an adapter that lets {model.needs.loop_rate:.0f} goals a second "
                f"of a {model.name} through, found one whose latency timer is {timer * 1e3:.0f} ms; {LATENCY_REMEDY}"
            )

    def connect(self, *, keep_torque: bool = False) -> Sequence[DriveIdentity]:
        """Open the adapter, identify every motor, and only then set up any of them, without torque."""
        self.bus.open()
        try:
            self.allow_for_adapter()
            texts = {tendon: self._identify(live) for tendon, live in self._live.items()}
            for live in self._live.values():
                seen = self.bus.order(frames.refresh(live.motor.motor_id), live.motor.motor_id, ATTEMPTS)
                mode = self.bus.get(live.motor.motor_id, Register.CONTROL_MODE, ATTEMPTS)
                if keep_torque and seen.state == DamiaoState.ENABLED and mode == frames.FORCE_POSITION_MODE:
                    # Nobody can ask a motor for its goal: it holds where it stands.
                    self._after_set_up(live)
                    live.powered, live.goal = True, live.motor.spool.length(seen.position)
                else:
                    for _ in self._set_up(live, ATTEMPTS):
                        pass
        except DriverError:
            self.bus.close()
            raise
        warnings = () if self._timeout else (NO_WATCHDOG,)
        return [DriveIdentity(tendon, text, warnings) for tendon, text in texts.items()]

    def _identify(self, live: _Live) -> str:
        motor, ranges = live.motor, live.motor.model.ranges
        where = f"tendon '{motor.tendon}', motor {motor.motor_id}"
        try:
            ratio = self.bus.get(motor.motor_id, Register.GEAR_RATIO, ATTEMPTS)
        except NoReplyError as error:
            raise DeviceNotFoundError(
                f"{where}: expected a {motor.model.name} on port {self.bus.link.path}, found {self._who_answers()}"
            ) from error
        found = [self.bus.get(motor.motor_id, one, ATTEMPTS) for one in _RANGES]
        expected = [ranges.position, ranges.speed, ranges.torque]
        if not math.isclose(ratio, motor.model.gear_ratio, rel_tol=0.05):
            raise WrongDeviceError(
                f"{where}: expected a {motor.model.name} with a gear ratio of {motor.model.gear_ratio:g}, found "
                f"{ratio:g}; correct the parameter servo_models"
            )
        if not all(math.isclose(a, b, rel_tol=1e-3) for a, b in zip(found, expected, strict=True)):
            raise WrongDeviceError(
                f"{where}: expected PMAX, VMAX, TMAX of {expected}, found {found}; its feedback would be misread: set "
                "them with the maker's tool"
            )
        live.max_current = self.bus.get(motor.motor_id, Register.MAX_CURRENT, ATTEMPTS)
        version = self.bus.get(motor.motor_id, Register.SOFTWARE_VERSION, ATTEMPTS)
        return f"{motor.model.name} id {motor.motor_id} sw {version:.0f}"

    def _who_answers(self) -> str:
        ids = range(1, frames.MAX_ID + 1)
        found = sorted(self.bus.feedbacks([frames.refresh(one) for one in ids], ids))
        if found:
            return f"ID {', '.join(map(str, found))} instead; {MISSING_SERVO_REMEDY} with the maker's tool"
        return "nobody; check power, cable, terminators, and that the motors are set to 1 Mbit/s"

    def _set_up(self, live: _Live, attempts: int) -> Iterator[None]:
        motor_id = live.motor.motor_id
        where = f"tendon '{live.motor.tendon}', motor {motor_id}"
        seen = self.bus.order(frames.disable(motor_id), motor_id, attempts)
        yield
        if seen.state not in (DamiaoState.DISABLED, DamiaoState.ENABLED):
            self.bus.order(frames.clear_error(motor_id), motor_id, attempts)
            yield
        required = {
            Register.CONTROL_MODE: frames.FORCE_POSITION_MODE,
            Register.TIMEOUT: round(self._timeout / frames.TIMEOUT_S_PER_UNIT),
        }
        for register, value in required.items():
            found = self.bus.get(motor_id, register, attempts)
            yield
            if found == value:
                continue
            name = register.name.lower()
            self._report(f"{where}: {name} is {found:g}, needs {value}; it is written now, until the power goes")
            if self.bus.put(motor_id, register, value, attempts) != value:
                raise WrongDeviceError(f"{where}: {name} was written, but not kept")
            yield
        self._after_set_up(live)

    def _after_set_up(self, live: _Live) -> None:
        live.met()
        live.powered = False
        live.goal = live.target = math.nan
        live.mark = live.order = None
        live.goal_speed.restart()

    def _let_go(self, live: _Live) -> None:
        self.bus.order(frames.disable(live.motor.motor_id), live.motor.motor_id, 3)

    def restore(self, tendon: str) -> Iterator[None]:
        """Clear a motor's error and set it up again; its mark goes, so that it has to be homed."""
        live = self._live[tendon]
        live.powered = live.mark = None
        deadline = self.bus.clock.now_s() + RESTORE_TIMEOUT_S
        while True:
            try:
                yield from self._set_up(live, 1)
                self._write_mark(live, 0)
            except NoReplyError:
                if self.bus.clock.now_s() > deadline:
                    raise
                yield
            else:
                return

    # --- a cycle ---------------------------------------------------------------------------------------------------

    def read(self) -> Mapping[str, DriveReading]:
        """Ask all present motors at once, one slow item, and probe one that is missing."""
        now = self.bus.clock.now_s()
        is_in_jerk = self._is_in_jerk(now)
        present = self._present()
        ids = [live.motor.motor_id for live in present]
        found = self.bus.feedbacks([frames.refresh(one) for one in ids], ids)
        at_order = self.bus.take_order_feedbacks()
        readings = {}
        for live in present:
            seen = found.get(live.motor.motor_id)
            if seen is None:
                self._missed(live, now)
            else:
                before_jerk = at_order.get(live.motor.motor_id) if is_in_jerk else None
                readings[live.motor.tendon] = self._reading(live, seen, before_jerk)
        self._probe(now, readings)
        self._read_slowly(readings)
        return readings

    def write(self, setpoints: Mapping[str, Setpoint]) -> None:
        """Send each powered motor its goal and its limit in one frame."""
        orders = []
        now = self.bus.clock.now_s()
        for tendon, setpoint in setpoints.items():
            live = self._live[tendon]
            if live.absent or not live.powered:
                continue
            motor = live.motor
            if setpoint.position is not None:
                live.target = motor.angle(setpoint.position)
            if math.isnan(live.target):
                continue
            share = motor.current(setpoint.tension_limit) / live.max_current
            speed = live.goal_speed.update(now, live.target)
            live.order = frames.force_position(motor.motor_id, live.target, speed, share)
            orders.append(live.order)
        if orders:
            self._order_period, self._ordered_at = now - self._ordered_at, now
            self.bus.send(orders)

    def power(self, tendon: str, on: bool) -> None:
        """Hold the present position, or let go."""
        live = self._live[tendon]
        motor_id = live.motor.motor_id
        # Unknown until it has been read, however far this gets.
        live.powered = live.order = None
        if on:
            # An order without current first: the goal of before must never meet the torque.
            live.goal_speed.restart()
            live.target = self._command(live, frames.refresh(motor_id)).position
            without_current = frames.force_position(motor_id, live.target, 0.0, 0.0)
            self._command(live, without_current)
            self._command(live, frames.enable(motor_id))
            live.order = without_current
        else:
            self._command(live, frames.disable(motor_id))

    def mark_session(self, tendon: str, mark: int) -> None:
        """Keep the mark in the over-temperature limit, up to 0.3 degC below it, where a restart puts it back."""
        self._write_mark(self._live[tendon], mark)

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _command(self, live: _Live, order: Frame) -> Feedback:
        self._repeat_orders()
        return self.bus.order(order, live.motor.motor_id, 2)

    def _repeat_orders(self) -> None:
        """Give each motor the order that it has: what takes several questions to one must not let others time out."""
        self.bus.send([live.order for live in self._live.values() if live.order is not None and not live.absent])

    def _write_mark(self, live: _Live, mark: int) -> None:
        self._repeat_orders()
        limit = math.ceil(self.bus.get(live.motor.motor_id, Register.OVER_TEMPERATURE, 2) - DEGC_PER_MARK / 2)
        self._repeat_orders()
        self.bus.put(live.motor.motor_id, Register.OVER_TEMPERATURE, limit - mark * DEGC_PER_MARK, 2)
        live.mark = mark

    def _is_in_jerk(self, now: float) -> bool:
        """Return whether the jerk of the goals before shows in what motors are asked now; see `_reading`."""
        loop_rate = max(live.motor.model.needs.loop_rate for live in self._live.values())
        is_smooth = self._order_period < self.LONGEST_SHARE / loop_rate
        return is_smooth and now - self._ordered_at < self.JERK_SHARE * self._order_period

    def _reading(self, live: _Live, seen: Feedback, before_jerk: Feedback | None = None) -> DriveReading:
        """Return what a motor says.

        A goal gives the stiff position loop a jerk. Where an adapter keeps bytes back, goals go out so late that the
        next question finds its torque in the midst of it: with what the motor saw as the goal came it makes a mean.
        """
        live.met()
        motor = live.motor
        live.powered = seen.state == DamiaoState.ENABLED
        torque = seen.torque if before_jerk is None else 0.5 * (seen.torque + before_jerk.torque)
        current, pull, stddev = motor.pull(replace(seen, torque=torque))
        fault = _FAULT_NAMES.get(seen.state, "")
        return DriveReading(
            self.bus.clock.now_s(), motor.spool.length(seen.position), motor.spool.length(seen.speed),
            max(0.0, pull), stddev, pull, current, seen.rotor, live.voltage, live.powered, live.mark,
            (fault,) if fault else (), "", seen.state if fault else 0,
        )  # fmt: skip

    @staticmethod
    def _missed(live: _Live, now: float) -> None:
        live.missed(now)
        if live.absent:
            live.mark = None  # what is read of it next may be after a restart

    def _ask(self, live: _Live) -> DriveReading | None:
        motor_id = live.motor.motor_id
        return self._reading(live, self.bus.order(frames.refresh(motor_id), motor_id))

    def _read_slowly(self, readings: Mapping[str, DriveReading]) -> None:
        """Ask one motor whether it still has its mark, or for its supply; one whose mark is not known comes first."""
        answering = [live for live in self._live.values() if live.motor.tendon in readings]
        unknown = next((live for live in answering if live.mark is None), None)
        self._cycles += 1
        if not answering or (unknown is None and self._cycles % self.SLOW_EVERY):
            return
        turn = self._cycles // self.SLOW_EVERY
        live = unknown or answering[turn // 2 % len(answering)]
        try:
            if unknown is not None or turn % 2:
                value = self.bus.get(live.motor.motor_id, Register.OVER_TEMPERATURE)
                live.mark = round((math.ceil(value - DEGC_PER_MARK / 2) - value) / DEGC_PER_MARK)
            else:
                live.voltage = self.bus.get(live.motor.motor_id, Register.SUPPLY_VOLTAGE)
        except PortLostError:
            raise
        except DriverError:
            return  # counted by the bus; the next feedback tells whether it is gone


_RANGES = (Register.POSITION_RANGE, Register.SPEED_RANGE, Register.TORQUE_RANGE)


def check_ids(ids: Sequence[int]) -> None:
    """Raise ConfigurationError for an ID that a feedback cannot carry."""
    wrong = [one for one in ids if not 1 <= one <= frames.MAX_ID]
    if wrong:
        raise ConfigurationError(
            f"parameter servo_ids: expected 1 to {frames.MAX_ID} with backend 'damiao', found {wrong}; a motor's "
            "feedback carries no more of its ID"
        )
