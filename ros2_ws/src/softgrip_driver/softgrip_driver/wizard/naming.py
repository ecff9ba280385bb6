# SPDX-License-Identifier: Apache-2.0
"""One new servo on the cable: found at whatever baud rate, given its ID and baud rate, verified."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from softgrip_driver.commands.scan import scan_port
from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DeviceNotFoundError,
    NoReplyError,
    WrongDeviceError,
)
from softgrip_driver.wizard.drive_setup import DriveSetup, FoundServo, SetupBus, SetupModel, setup_names
from softgrip_time import Clock

#: [s] for the answers at each baud rate
SCAN_WAIT_S = 0.2
SCAN_ROUNDS = 2
#: [s] after which a servo that was just fed answers: more than twice what an X series servo takes
BOOT_S = 1.0


def find_new_servo(
    setup: DriveSetup, port: str, baud: int, known_ids: Collection[int], clock: Clock | None = None
) -> FoundServo:
    """Return the only servo that is not one of the chain.

    Args:
        setup: of its make.
        port: of the bus.
        baud: [1/s] of the chain.
        known_ids: IDs of the chain.
        clock: that is waited on; the computer's where none is given.

    Raises:
        ConfigurationError: several new ones, with one ID or with different ones.
        DeviceNotFoundError: none.
        PortLostError: of the port.
    """
    for number in range(SCAN_ROUNDS):
        if number:  # the first round may have met a servo that boots
            clock = setup.make_bus(port, baud, 0.0, clock).clock
            clock.wait(clock.now_s() + BOOT_S)
        found = list(scan_port(setup, port, setup.bauds, SCAN_WAIT_S, clock))
        _refuse_shared(found, baud, known_ids)
        new = [one for one in found if not (one.baud == baud and one.servo_id in known_ids)]
        if new:
            break
    else:
        others = ", ".join(name for name in setup_names() if name != setup.name)
        raise DeviceNotFoundError(
            f"expected a new {setup.name} servo, found none at any baud rate; {setup.supply_remedy}; for those of "
            f"another make give --drive ({others})"
        )
    if len(new) > 1:
        listed = ", ".join(f"ID {one.servo_id} at {one.baud} baud" for one in new)
        raise ConfigurationError(f"expected one new servo, found {listed}; leave one of them on the cable")
    return new[0]


def _refuse_shared(found: Iterable[FoundServo], baud: int, known_ids: Collection[int]) -> None:
    """Raise ConfigurationError where several servos answer to one ID."""
    for one in found:
        if one.is_shared:
            is_known = one.baud == baud and one.servo_id in known_ids
            raise ConfigurationError(
                f"expected one new servo, found several with ID {one.servo_id} at {one.baud} baud"
                f"{', one of them in the chain' * is_known}; leave one on the cable: servos come with the same ID, and "
                "each gets its own only while it is the only new one"
            )


def model_found(setup: DriveSetup, found: FoundServo) -> SetupModel:
    """Return the model of a servo; raises WrongDeviceError for one that can pull no tendon here."""
    model = next((one for one in setup.models.values() if one.number == found.number), None)
    if model is None:
        name = setup.model_names.get(found.number, "an unknown model")
        raise WrongDeviceError(
            f"expected one of {', '.join(sorted(setup.models))}, found {name} (number {found.number})"
        )
    return model


def describe_past(setup: DriveSetup, found: FoundServo) -> str:
    """Return what is not as a new servo has it, empty for a new one."""
    servo_id, baud = setup.factory
    if (found.servo_id, found.baud) == setup.factory:
        return ""
    return (
        f"it was used: expected ID {servo_id} at {baud} baud, found ID {found.servo_id} at {found.baud}"
        "; it is set up all the same"
    )


def name_servo(
    setup: DriveSetup, found: FoundServo, servo_id: int, baud: int, reply_margin: float, clock: Clock | None = None
) -> Sequence[str]:
    """Give a servo its ID and baud rate, verify both and its supply; return what was done.

    Raises:
        WrongDeviceError: another supply than its model takes, or a setting that it does not keep.
        DriverError: as `DriveSetup.assign`.
    """
    bus = setup.make_bus(found.port, found.baud, reply_margin, clock)
    bus.open()
    try:
        done = setup.assign(bus, found.servo_id, servo_id, baud)
        model = model_found(setup, found)
        if setup.model_number(bus, servo_id) != model.number:
            raise WrongDeviceError(
                f"expected a {model.name} with ID {servo_id}, found another one; scan shows who is there"
            )
        volts = setup.health(bus, servo_id).voltage_v
        low, high = model.voltage_range
        if not low <= volts <= high:
            raise WrongDeviceError(
                f"expected a supply of {low:g} to {high:g} V for a {model.name}, found {volts:.1f} V; "
                f"{setup.supply_remedy}"
            )
    finally:
        bus.close()
    return [*done, f"supply {volts:.1f} V"]


def is_verified(setup: DriveSetup, bus: SetupBus, servo_id: int, model: str) -> bool:
    """Whether a servo of an earlier session answers as what it was then."""
    try:
        number = setup.model_number(bus, servo_id)
    except (NoReplyError, CorruptReplyError):
        return False
    return setup.models[model].number == number and not setup.is_shared(bus, servo_id)
