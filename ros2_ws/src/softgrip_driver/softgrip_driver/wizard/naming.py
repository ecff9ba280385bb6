# SPDX-License-Identifier: Apache-2.0
"""One new servo on the cable: found at whatever baud rate, given its ID and baud rate, verified."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from softgrip_driver.commands.scan import Found, scan_port
from softgrip_driver.commands.setup import assign
from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bringup import BOOT_LOADER_REMEDY, FACTORY_BAUD
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import BAUD_CODES, MODEL_NAMES, MODELS, ServoModel
from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DeviceNotFoundError,
    NoReplyError,
    WrongDeviceError,
)
from softgrip_time import Clock

#: [s] for the answers at each baud rate
SCAN_WAIT_S = 0.2
SCAN_ROUNDS = 2
FACTORY_ID = 1
#: a new servo is there, or at the baud rate that this project uses; others are looked at last
_BAUDS = sorted(BAUD_CODES, key=lambda baud: (baud != FACTORY_BAUD, baud != 1_000_000))
SUPPLY_REMEDY = (
    "check that the servos' supply is on (a U2D2 feeds no servo), the cable, and that its LED flashes when power comes"
)


def find_new_servo(port: str, baud: int, known_ids: Collection[int], clock: Clock | None = None) -> Found:
    """Return the only servo that is not one of the chain.

    Args:
        port: of the bus.
        baud: [1/s] of the chain.
        known_ids: IDs of the chain.
        clock: that is waited on; the computer's where none is given.

    Raises:
        ConfigurationError: several new ones, with one ID or with different ones.
        DeviceNotFoundError: none.
        PortLostError: of the port.
    """
    # The first round may meet a servo that boots.
    for _ in range(SCAN_ROUNDS):
        found = list(scan_port(port, _BAUDS, SCAN_WAIT_S, clock))
        _refuse_shared(found, baud, known_ids)
        new = [one for one in found if not (one.baud == baud and one.servo_id in known_ids)]
        if new:
            break
    else:
        raise DeviceNotFoundError(
            f"expected a new servo, found none at any baud rate; {SUPPLY_REMEDY}; {BOOT_LOADER_REMEDY}"
        )
    if len(new) > 1:
        listed = ", ".join(f"ID {one.servo_id} at {one.baud} baud" for one in new)
        raise ConfigurationError(f"expected one new servo, found {listed}; leave one of them on the cable")
    return new[0]


def _refuse_shared(found: Iterable[Found], baud: int, known_ids: Collection[int]) -> None:
    """Raise ConfigurationError where several servos answer to one ID."""
    for one in found:
        if one.shared:
            is_known = one.baud == baud and one.servo_id in known_ids
            raise ConfigurationError(
                f"expected one new servo, found several with ID {one.servo_id} at {one.baud} baud"
                f"{', one of them in the chain' * is_known}; leave one on the cable: servos come with the same ID, and "
                "each gets its own only while it is the only new one"
            )


def model_of(found: Found) -> ServoModel:
    """Return the model of a servo; raises WrongDeviceError for one that can pull no tendon here."""
    model = next((one for one in MODELS.values() if one.number == found.model), None)
    if model is None:
        name = MODEL_NAMES.get(found.model, "an unknown model")
        raise WrongDeviceError(f"expected one of {', '.join(sorted(MODELS))}, found {name} (number {found.model})")
    return model


def describe_past(found: Found) -> str:
    """Return what is not as a new servo has it, empty for a new one."""
    if (found.servo_id, found.baud) == (FACTORY_ID, FACTORY_BAUD):
        return ""
    return (
        f"it was used: expected ID {FACTORY_ID} at {FACTORY_BAUD} baud, found ID {found.servo_id} at {found.baud}"
        "; it is set up all the same"
    )


def name_servo(found: Found, servo_id: int, baud: int, reply_margin: float, clock: Clock | None = None) -> list[str]:
    """Give a servo its ID and baud rate, verify both and its supply; return what was done.

    Raises:
        WrongDeviceError: another supply than its model takes, or a setting that it does not keep.
        DriverError: as `assign`.
    """
    bus = Bus(found.port, found.baud, reply_margin, clock)
    bus.open()
    try:
        done = assign(bus, found.servo_id, servo_id, baud)
        model = model_of(found)
        if bus.read(servo_id, reg.ID, attempts=3) != servo_id or bus.ping(servo_id, attempts=3)[0] != model.number:
            raise WrongDeviceError(
                f"expected a {model.name} with ID {servo_id}, found another one; scan shows who is there"
            )
        volts = bus.read(servo_id, reg.PRESENT_VOLTAGE, attempts=3) * reg.VOLT_PER_UNIT
        low, high = model.voltage_range
        if not low <= volts <= high:
            raise WrongDeviceError(
                f"expected a supply of {low:g} to {high:g} V for a {model.name}, found {volts:.1f} V; {SUPPLY_REMEDY}"
            )
        done.append(f"supply {volts:.1f} V")
    finally:
        bus.close()
    return done


def is_verified(bus: Bus, servo_id: int, model: str) -> bool:
    """Whether a servo of an earlier session answers as what it was then."""
    try:
        number, _ = bus.ping(servo_id, attempts=3)
    except (NoReplyError, CorruptReplyError):
        return False
    return MODELS[model].number == number and not bus.is_shared(servo_id)
