# SPDX-License-Identifier: Apache-2.0
"""Bringing one Feetech servo up: is it the right one, are its persistent settings right, and its volatile ones set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from softgrip_driver.errors import (
    MISSING_SERVO_REMEDY,
    CorruptReplyError,
    DeviceNotFoundError,
    NoReplyError,
    WrongDeviceError,
)
from softgrip_driver.feetech import registers as reg
from softgrip_driver.feetech.bus import FeetechBus
from softgrip_driver.feetech.registers import FeetechItem, FeetechStatusBits, PhaseBits
from softgrip_driver.feetech.servo import FeetechServo
from softgrip_driver.tendon.bus_backend import refuse

ATTEMPTS = 4
_SCANNED = range(21)


@dataclass(frozen=True)
class SettingDifference:
    """A persistent setting that is not as a tendon drive needs it."""

    servo: FeetechServo
    item: FeetechItem
    found: int
    required: int

    def __str__(self) -> str:
        """Return it in words."""
        where = f"tendon '{self.servo.tendon}', ID {self.servo.servo_id}"
        return f"{where}: {self.item.name} is {self.found}, needs {self.required}"


def identify(bus: FeetechBus, servo: FeetechServo) -> tuple[FeetechServo, str]:
    """Return the servo with what its firmware says of its units, and who it is in words.

    Raises:
        DeviceNotFoundError: nobody answers at its ID; the message says who does.
        WrongDeviceError: another model, or a servo that is in error.
    """
    try:
        number = bus.get(servo.servo_id, reg.MODEL_NUMBER, ATTEMPTS)
    except (NoReplyError, CorruptReplyError) as error:
        raise DeviceNotFoundError(
            f"tendon '{servo.tendon}': expected a {servo.model.name} with ID {servo.servo_id} at {bus.link.baud} baud "
            f"on port {bus.link.path}, found {_who_answers(bus)}"
        ) from error
    if number != servo.model.number:
        name = reg.MODEL_NAMES.get(number, "an unknown model")
        remedy = "it counts no turns, so no tendon can hang on it" if number in reg.SCS_NUMBERS else (
            "correct the parameter servo_models"
        )  # fmt: skip
        raise WrongDeviceError(
            f"tendon '{servo.tendon}', ID {servo.servo_id}: expected model {servo.model.name} ({servo.model.number}), "
            f"found {name} ({number}); {remedy}"
        )
    phase = PhaseBits(bus.get(servo.servo_id, reg.PHASE, ATTEMPTS) & (PhaseBits.FINE_SPEED | PhaseBits.COUNTS_TURNS))
    unit = reg.RAD_PER_S_FINE if phase & PhaseBits.FINE_SPEED else reg.RAD_PER_S_COARSE
    firmware = bus.get(servo.servo_id, reg.FIRMWARE, ATTEMPTS)
    text = f"{servo.model.name}/{number} id {servo.servo_id} fw {firmware & 0xFF}.{firmware >> 8}"
    return replace(servo, rad_per_s=unit), text


def _who_answers(bus: FeetechBus) -> str:
    found = []
    for one in _SCANNED:
        try:
            bus.ping(one)
        except NoReplyError:
            continue
        except CorruptReplyError:
            return f"several servos with ID {one}; connect them one at a time and give each an ID of its own"
        found.append(one)
    if found:
        return f"ID {', '.join(map(str, found))} instead; {MISSING_SERVO_REMEDY} with the maker's tool"
    return "nobody; check power, cable and baud rate (1000000 as they come)"


def examine(bus: FeetechBus, servo: FeetechServo, attempts: int = ATTEMPTS) -> Iterator[SettingDifference | None]:
    """Yield each persistent setting that differs from what is needed, None for one that does not. Changes none.

    Raises:
        WrongDeviceError: the servo's encoder fails.
        DriverError: the servo does not answer.
    """
    if FeetechStatusBits.ENCODER & bus.get(servo.servo_id, reg.STATUS, attempts):
        raise WrongDeviceError(
            f"tendon '{servo.tendon}', ID {servo.servo_id}: expected a servo whose encoder works, found its error bit "
            "set; replace the servo"
        )
    phase = bus.get(servo.servo_id, reg.PHASE, attempts)
    required = {
        reg.RESPONSE_LEVEL: 1,
        # both 0, and an angle that counts turns: absolute positions over several turns
        reg.MIN_ANGLE: 0,
        reg.MAX_ANGLE: 0,
        reg.PHASE: phase | PhaseBits.COUNTS_TURNS,
        reg.ANGLE_RESOLUTION: 1,
        reg.MODE: 0,
        reg.UNLOADING: int(reg.UNLOADING_BITS),
        reg.MAX_TORQUE: servo.max_torque_units,
    }
    for item, value in required.items():
        found = phase if item is reg.PHASE else bus.get(servo.servo_id, item, attempts)
        yield None if found == value else SettingDifference(servo, item, found, value)


def set_up(bus: FeetechBus, servo: FeetechServo, *, write_eeprom: bool, attempts: int = ATTEMPTS) -> Iterator[None]:
    """Bring a servo to a known state with its torque off, some short transactions a step.

    Raises:
        WrongDeviceError: its encoder fails, or it does not keep a setting.
        ConfigurationError: settings differ and may not be written.
        DriverError: it does not answer.
    """
    servo_id = servo.servo_id
    differences = []
    for difference in examine(bus, servo, attempts):
        if difference is not None:
            differences.append(difference)
        yield
    if not write_eeprom:
        refuse(differences)
    bus.put(servo_id, reg.TORQUE_ENABLE, 0, attempts)
    if differences:
        bus.put(servo_id, reg.LOCK, 0, attempts)
        yield
    for difference in differences:
        bus.put(servo_id, difference.item, difference.required, attempts)
        if bus.get(servo_id, difference.item, attempts) != difference.required:
            raise WrongDeviceError(f"{difference}; it was written, but not kept")
        yield
    bus.put(servo_id, reg.LOCK, 1, attempts)
    for item, value in volatile(servo).items():
        bus.put(servo_id, item, value, attempts)
        yield
    bus.put(servo_id, reg.TORQUE_LIMIT, servo.duty_units(0.0, servo.standing()), attempts)


def volatile(servo: FeetechServo) -> dict[FeetechItem, int]:
    """Return the servo's own profile: a last limit above the setpoint's speed."""
    return {reg.ACCELERATION: 0, reg.GOAL_SPEED: servo.speed_units(servo.own_speed)}


def is_left_holding(bus: FeetechBus, servo: FeetechServo) -> bool:
    """Return whether a servo holds with the very settings that `set_up` would give it; nothing is changed."""
    if bus.get(servo.servo_id, reg.TORQUE_ENABLE, ATTEMPTS) != 1:
        return False
    if any(difference is not None for difference in examine(bus, servo)):
        return False
    return bus.get(servo.servo_id, reg.ACCELERATION, ATTEMPTS) == 0
