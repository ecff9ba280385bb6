# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver setup`: give a servo its ID and baud rate, or reboot it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from softgrip_driver.commands.common import BAUDS, DONE, add_bus_options, add_drive_option, parser, run
from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bringup import SHARED_ID_REMEDY
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.restart import restart
from softgrip_driver.errors import ConfigurationError, CorruptReplyError, NoReplyError
from softgrip_driver.wizard.drive_setup import drive_setup

TEXT = """Set up one servo: its ID, its baud rate, no return delay. Torque is switched off first.

A new Dynamixel has ID 1 at 57600 baud, a new Feetech (--drive feetech) ID 1 at 1 Mbaud. Connect one at a time:
    setup --port /dev/ttyUSB0 --baud 57600 --id 1 --new-id 3 --new-baud 1000000
After an overload or another hardware error:
    setup --port /dev/ttyUSB0 --id 3 --reboot"""


def assign(bus: Bus, servo_id: int, new_id: int | None, new_baud: int | None) -> list[str]:
    """Write what was asked for, verify it, and say what was done.

    Raises:
        ConfigurationError: the new ID is taken, or several servos have the present one.
        DriverError: the servo does not answer or refuses.
    """
    done = []
    model, _ = bus.ping(servo_id, attempts=3)
    if bus.is_shared(servo_id):
        raise ConfigurationError(f"expected one servo with ID {servo_id}, found several; {SHARED_ID_REMEDY}")
    bus.write(servo_id, reg.TORQUE_ENABLE, 0, attempts=3)
    bus.write(servo_id, reg.RETURN_DELAY, 0, attempts=3)
    done.append(f"ID {servo_id} ({reg.MODEL_NAMES.get(model, model)}): torque off, return delay 0")
    if new_id is not None and new_id != servo_id:
        try:
            bus.ping(new_id)
        except (NoReplyError, CorruptReplyError):
            pass
        else:
            raise ConfigurationError(f"expected a free ID, found a servo with ID {new_id} already; choose another")
        bus.write(servo_id, reg.ID, new_id)
        servo_id = new_id
        bus.ping(servo_id, attempts=3)
        done.append(f"ID is now {servo_id}")
    if new_baud is not None and new_baud != bus.port.baudrate:
        bus.write(servo_id, reg.BAUD_RATE, reg.BAUD_CODES[new_baud])
        bus.close()
        bus.port.baudrate = new_baud
        bus.open()
        bus.ping(servo_id, attempts=3)
        done.append(f"baud rate is now {new_baud}")
    return done


def reboot(bus: Bus, servo_id: int) -> str:
    """Reboot a servo, wait for it, and say how it is.

    Raises:
        NoReplyError: it does not answer at all.
        DeviceNotFoundError: it does not come back.
    """
    bus.ping(servo_id, attempts=3)
    for _ in restart(bus, servo_id):
        pass
    error = reg.HardwareError(bus.read(servo_id, reg.HARDWARE_ERROR, attempts=3))
    return f"ID {servo_id} is back, hardware error: {error.name or 'none'}; home its tendon"


def work(options: argparse.Namespace) -> int:
    """Do what was asked for."""
    setup = drive_setup(options.drive)
    bus = setup.make_bus(options.port, options.baud, options.reply_margin, None)
    if options.reboot and not isinstance(bus, Bus):
        raise ConfigurationError(
            f"--reboot: expected Dynamixel servos, found drive '{setup.name}'; "
            f"{setup.reset_remedy(options.port, options.baud, options.id)}"
        )
    bus.open()
    try:
        if options.reboot:
            print(reboot(bus, options.id))
        if options.new_id is not None or options.new_baud is not None or not options.reboot:
            print("\n".join(setup.assign(bus, options.id, options.new_id, options.new_baud)))
    finally:
        bus.close()
    return DONE


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("setup", TEXT)
    add_bus_options(arguments)
    add_drive_option(arguments)
    arguments.add_argument("--id", type=int, required=True, choices=range(253), metavar="0..252", help="present ID")
    arguments.add_argument("--new-id", type=int, choices=range(253), metavar="0..252")
    arguments.add_argument("--new-baud", type=int, choices=sorted(BAUDS))
    arguments.add_argument(
        "--reboot", action="store_true", help="reboot it; clears a hardware error and its turn count"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
