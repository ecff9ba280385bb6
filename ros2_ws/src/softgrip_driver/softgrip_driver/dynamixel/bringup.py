# SPDX-License-Identifier: Apache-2.0
"""Bringing one servo up: is it the right one, are its persistent settings right, and its volatile ones set."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import (
    BAUD_CODES,
    MODEL_NAMES,
    ControlItem,
    CurrentSensing,
    HardwareError,
    OperatingMode,
    ServoModel,
)
from softgrip_driver.errors import (
    MISSING_SERVO_REMEDY,
    CorruptReplyError,
    DeviceNotFoundError,
    NoReplyError,
    WrongDeviceError,
)
from softgrip_driver.tendon.bus_backend import refuse
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.tendon.winding import RATED_DEGC, MotorReading, Winding, WindingWarmth

_ATTEMPTS = 4
#: [1/s] as a servo comes (e-manual, Baud Rate(8))
FACTORY_BAUD = 57600
SHARED_ID_REMEDY = (
    "connect them one at a time; the wizard gives each an ID of its own then, and without the wizard "
    "`ros2 run softgrip_driver setup --id 1 --new-id N` does"
)
BOOT_LOADER_REMEDY = (
    "a servo whose LED stays lit after power-on waits for its firmware: recover it with DYNAMIXEL Wizard 2.0"
)
SUPPLY_REMEDY = (
    "check that the servos' supply is on (a U2D2 feeds no servo), the cable, and that its LED flashes when power "
    f"comes; {BOOT_LOADER_REMEDY}"
)


@dataclass(frozen=True)
class ServoConfiguration:
    """One servo of the configuration.

    Attributes:
        tendon: name of the tendon on its spool.
        servo_id: 0 .. 252.
        model: its control table.
        spool, torque: between shaft and tendon.
        mode: current-based position (5), or extended position (4), where the software limits the tension; a model that
            knows no current limits it there by its duty cycle.
        tension_hard: [N] the servo's own current limit is set a tenth above it.
        speed: [m/s] the servo's own profile velocity; a last limit above that of the setpoint.
        winding: resistance and back-EMF where measured; None = the data sheet's.
        limits: which current its goal and limit act on; None = the one it senses.
        fast_sync_read: the firmware has it (known after `identify`).
    """

    tendon: str
    servo_id: int
    model: ServoModel
    spool: Spool
    torque: TorqueModel
    mode: OperatingMode = OperatingMode.CURRENT_BASED_POSITION
    tension_hard: float = 45.0
    speed: float = 0.05
    winding: Winding | None = None
    limits: CurrentSensing | None = None
    fast_sync_read: bool = False

    @property
    def motor(self) -> Winding:
        """Resistance and back-EMF."""
        return self.winding or Winding(self.model.resistance, self.model.back_emf)

    @property
    def limits_supply(self) -> bool:
        """Whether goal current and current limit act on the supply's current."""
        return (self.limits or self.model.senses) is CurrentSensing.SUPPLY

    @property
    def has_current_limit(self) -> bool:
        """Whether the servo itself limits the tension."""
        return self.has_current_goal and self.mode is OperatingMode.CURRENT_BASED_POSITION

    @property
    def has_current_goal(self) -> bool:
        """Whether the model has a goal current and a current limit at all."""
        return self.model.senses is not CurrentSensing.NONE

    @property
    def limit_item(self) -> ControlItem | None:
        """The item by which the servo itself limits the tension; None where it does not.

        "In other control modes, this value is used to limit PWM value": e-manual, Goal PWM(100).
        """
        if not self.has_current_goal:
            return reg.GOAL_PWM
        return reg.GOAL_CURRENT if self.has_current_limit else None

    def limit_units(self, tension: float, seen: MotorReading | None = None) -> int:
        """Return what to write into `limit_item` for a tension limit [N] in a state of the motor (None: at rest)."""
        return self.current_units(tension, seen) if self.has_current_goal else self.duty_units(tension, seen)

    @property
    def mark_item(self) -> ControlItem:
        """The item that keeps the session mark: a restart puts it back, and position control does without it."""
        return reg.GOAL_PWM if self.has_current_goal else reg.GOAL_VELOCITY

    def mark_units(self, mark: int, pwm_limit: int) -> int:
        """Return what stands in `mark_item` for a mark; the other way round it is the same.

        The goal PWM keeps it up to 15 units (1.7 %) below its limit.
        """
        return pwm_limit - mark if self.has_current_goal else mark

    def length(self, pulses: int) -> float:
        """Return the tendon wound in [m] at a position [pulses]."""
        return self.spool.length(pulses * reg.RAD_PER_PULSE)

    def pulses(self, length: float) -> int:
        """Return the position [pulses] at a length [m], kept within the +-256 turns that the servo accepts."""
        pulses = round(self.spool.angle(length) / reg.RAD_PER_PULSE)
        return max(-reg.EXTENDED_POSITION_LIMIT, min(reg.EXTENDED_POSITION_LIMIT, pulses))

    def motor_reading(self, block: bytes, voltage: float, temperature: float) -> MotorReading:
        """Return what the items from Present PWM to Present Velocity say, + as the tendon is pulled."""
        sign = self.spool.direction
        return MotorReading(
            sign * reg.PRESENT_CURRENT.decode(block[2:4]) * self.model.ampere_per_unit,
            sign * reg.PRESENT_PWM.decode(block[0:2]) / reg.PWM_FULL_SCALE,
            sign * reg.PRESENT_VELOCITY.decode(block[4:8]) * reg.RAD_PER_S_PER_UNIT,
            voltage,
            temperature,
        )

    @property
    def current_limit_units(self) -> int:
        """The servo's own current limit: a tenth above the hard tension limit, within the model's range."""
        return min(self.model.current_limit_units, self._units(1.1 * self.tension_hard, self.standing()))

    def current_units(self, tension: float, seen: MotorReading | None = None) -> int:
        """Return the goal current for a tension limit [N]; one above the current limit would be refused.

        What the supply has to give for a tension depends on the state of the motor (None: at rest): while the shaft
        winds in, on its speed too. A motor that is stopped needs less, which is known after one cycle.
        """
        return max(1, min(self.current_limit_units, self._units(tension, seen or self.standing())))

    def duty_units(self, tension: float, seen: MotorReading | None = None) -> int:
        """Return the goal PWM for a tension limit [N]: the duty cycle that makes the current, at the shaft's speed.

        It bounds both directions, so it must leave room for paying out, too; a motor that is stopped needs less, which
        is known after one cycle.
        """
        seen = seen or self.standing()
        speed = min(abs(seen.speed), self.speed / self.spool.radius)
        voltage = max(seen.voltage, self.model.voltage_range[0])
        current = self.torque.current(tension, self.spool.radius)
        volts = self.motor.resistance_at(seen.temperature) * current + self.motor.back_emf * speed
        return max(1, min(reg.PWM_FULL_SCALE, round(reg.PWM_FULL_SCALE * volts / voltage)))

    def _units(self, tension: float, seen: MotorReading) -> int:
        current = self.torque.current(tension, self.spool.radius)
        if self.limits_supply:
            speed = max(0.0, min(seen.speed, self.speed / self.spool.radius))
            voltage = max(seen.voltage, self.model.voltage_range[0])
            current = self.motor.supply_current(current, speed, voltage, seen.temperature)
        return round(current / self.model.ampere_per_unit)

    def standing(self) -> MotorReading:
        """Return what is assumed of a motor until it has been read: at rest, on its rated supply, cool."""
        return MotorReading(0.0, 0.0, 0.0, self.model.rated_voltage, RATED_DEGC)

    @property
    def shows_warmth(self) -> bool:
        """Whether its currents show how warm the winding is: a calibration has held them against each other."""
        return self.model.senses is CurrentSensing.SUPPLY and self.winding is not None

    def pull(self, seen: MotorReading, warmth: WindingWarmth | None = None) -> tuple[float, float, float]:
        """Return the winding's current [A], and the force [N] on the tendon with its standard deviation [N]."""
        current, stddev = seen.current, 0.0
        if self.model.senses is not CurrentSensing.WINDING:
            current, stddev = self.motor.current(seen, warmth)
        radius = self.spool.radius
        return current, *self.torque.pull(current, seen.speed * radius, radius, stddev)


@dataclass(frozen=True)
class ServoIdentity:
    """A servo that was found to be the one configured."""

    servo: ServoConfiguration
    text: str


def identify(bus: Bus, servo: ServoConfiguration) -> ServoIdentity:
    """Return who answers at the servo's ID.

    Raises:
        DeviceNotFoundError: nobody; the message says where servos do answer.
        WrongDeviceError: another model.
    """
    try:
        number, firmware = bus.ping(servo.servo_id, attempts=_ATTEMPTS)
    except (NoReplyError, CorruptReplyError) as error:
        raise DeviceNotFoundError(
            f"tendon '{servo.tendon}': expected a {servo.model.name} with ID {servo.servo_id} at {bus.port.baudrate} "
            f"baud on {bus.port.port_name}, found {who_answers(bus)}"
        ) from error
    if number != servo.model.number:
        raise WrongDeviceError(
            f"tendon '{servo.tendon}', ID {servo.servo_id}: expected model {servo.model.name} ({servo.model.number}), "
            f"found {MODEL_NAMES.get(number, 'an unknown model')} ({number}); correct the parameter servo_models"
        )
    text = f"{servo.model.name}/{number} id {servo.servo_id} fw {firmware}"
    return ServoIdentity(replace(servo, fast_sync_read=firmware >= servo.model.fast_sync_read_firmware), text)


def who_answers(bus: Bus) -> str:
    """Return which IDs answer, at this baud rate and at the first other one where anybody does, and what to do."""
    found = bus.broadcast_ping(0.1)
    shared = [one for one in sorted(found) if bus.is_shared(one)]
    if shared:
        return f"several servos with ID {shared[0]}; {SHARED_ID_REMEDY}"
    here = f"ID {_listed(found)} instead" if found else ""
    other_baud, others = _at_another_rate(bus)
    if others:
        options = f"--port {bus.port.port_name} --baud {other_baud} --id {min(others)} --new-baud {bus.port.baudrate}"
        return (
            f"{here + ', and ' * bool(here)}ID {_listed(others)} at {other_baud} baud"
            f"{' (as new)' * (other_baud == FACTORY_BAUD)}; set each with `ros2 run softgrip_driver setup {options}`"
        )
    if here:
        return f"{here}; {MISSING_SERVO_REMEDY} with `ros2 run softgrip_driver setup --new-id`"
    return f"nobody at any baud rate; {SUPPLY_REMEDY}"


def _at_another_rate(bus: Bus) -> tuple[int, Collection[int]]:
    """Return the first other baud rate at which anybody answers, and who; nobody where there is none."""
    for baud in BAUD_CODES:
        if baud == bus.port.baudrate:
            continue
        other = Bus(bus.port.port_name, baud, bus.port.reply_margin, bus.clock)
        bus.close()
        try:
            other.open()
            found = other.broadcast_ping(0.1)
        finally:
            other.close()
            bus.open()
        if found:
            return baud, found
    return 0, ()


def _listed(found: Iterable[int]) -> str:
    return ", ".join(str(one) for one in sorted(found))


def required_eeprom(servo: ServoConfiguration) -> dict[ControlItem, int]:
    """Return the persistent settings a tendon drive needs."""
    settings = {
        reg.RETURN_DELAY: 0,
        reg.DRIVE_MODE: 0,
        reg.OPERATING_MODE: int(servo.mode),
        reg.SECONDARY_ID: 255,
        # The driver's own limit lies below it; at this one the servo lets go.
        reg.TEMPERATURE_LIMIT: round(servo.model.temperature_limit),
        reg.STARTUP_CONFIGURATION: 0,
        reg.SHUTDOWN: int(reg.SHUTDOWN_ERRORS),
    }
    return settings | ({reg.CURRENT_LIMIT: servo.current_limit_units} if servo.has_current_goal else {})


@dataclass(frozen=True)
class Difference:
    """A persistent setting that is not as a tendon drive needs it."""

    servo: ServoConfiguration
    item: ControlItem
    found: int
    required: int

    def __str__(self) -> str:
        """Return it in words."""
        where = f"tendon '{self.servo.tendon}', ID {self.servo.servo_id}"
        return f"{where}: {self.item.name} is {self.found}, needs {self.required}"


def examine(bus: Bus, servo: ServoConfiguration, attempts: int = _ATTEMPTS) -> Iterator[Difference | None]:
    """Yield each persistent setting that differs from what is needed, None for one that does not. Changes none.

    Raises:
        WrongDeviceError: the servo has a hardware error that needs a person.
        DriverError: the servo does not answer.
    """
    # Not answered by anybody: a servo told to keep silent would not tell that it did.
    bus.sync_write(reg.STATUS_RETURN_LEVEL, {servo.servo_id: reg.ANSWER_ALL})
    error = HardwareError(bus.read(servo.servo_id, reg.HARDWARE_ERROR, attempts))
    if error & ~HardwareError.INPUT_VOLTAGE:
        raise WrongDeviceError(
            f"tendon '{servo.tendon}', ID {servo.servo_id}: expected a servo without hardware errors, found {error!r}; "
            "remove the cause, then reboot it with `ros2 run softgrip_driver setup --reboot`"
        )
    for item, required in required_eeprom(servo).items():
        found = bus.read(servo.servo_id, item, attempts)
        yield None if found == required else Difference(servo, item, found, required)


def set_up(bus: Bus, servo: ServoConfiguration, *, write_eeprom: bool, attempts: int = _ATTEMPTS) -> Iterator[str]:
    """Bring a servo to a known state with its torque off, some short transactions a step.

    Yields each persistent setting that was corrected, in words, and "" after every other transaction. With one attempt
    no step waits for longer than a reply takes.

    A driver that starts again finds its own settings and changes nothing, so the servo's turn count and session mark
    survive.

    Raises:
        WrongDeviceError: the servo has a hardware error, or does not keep a setting.
        ConfigurationError: settings differ and may not be written.
        DriverError: the servo does not answer or refuses.
    """
    servo_id = servo.servo_id
    differences = []
    for difference in examine(bus, servo, attempts):
        if difference is not None:
            differences.append(difference)
        yield ""
    if not write_eeprom:
        refuse(differences)
    bus.write(servo_id, reg.TORQUE_ENABLE, 0, attempts)
    bus.write(servo_id, reg.BUS_WATCHDOG, 0, attempts)
    for difference in differences:
        bus.write(servo_id, difference.item, difference.required, attempts)
        if bus.read(servo_id, difference.item, attempts) != difference.required:
            raise WrongDeviceError(f"{difference}; it was written, but not kept")
        yield str(difference)
    # After the mode: a change of mode resets these.
    limit = reg.GOAL_CURRENT if servo.has_current_goal else reg.GOAL_PWM
    volatile = _profile(servo) | {limit: servo.limit_units(0.0)}
    for item, value in volatile.items():
        bus.write(servo_id, item, value, attempts)
        yield ""


def is_left_holding(bus: Bus, servo: ServoConfiguration) -> bool:
    """Return whether a servo holds with the very settings that `set_up` would give it; nothing is changed.

    Raises:
        WrongDeviceError: the servo has a hardware error.
        DriverError: the servo does not answer.
    """
    servo_id = servo.servo_id
    if not bus.read(servo_id, reg.TORQUE_ENABLE, _ATTEMPTS):
        return False
    if any(difference is not None for difference in examine(bus, servo)):
        return False
    return all(bus.read(servo_id, item, _ATTEMPTS) == value for item, value in _profile(servo).items())


def _profile(servo: ServoConfiguration) -> dict[ControlItem, int]:
    """Return the servo's own profile, a last limit above the setpoint's speed, and the gain for goals in steps.

    An XL430 comes with a D gain, others without. It would push and brake with each goal, and as Present PWM is read
    just before the next one, its braking would pass for less tension.
    """
    speed_units = abs(servo.spool.angle(servo.speed)) / reg.RAD_PER_S_PER_UNIT
    profile = {reg.PROFILE_ACCELERATION: 0, reg.PROFILE_VELOCITY: min(32767, max(1, round(2.0 * speed_units)))}
    return profile if servo.has_current_goal else profile | {reg.POSITION_D_GAIN: 0}
