# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver scan`: which servos answer, on which port, at which baud rate."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from serial.tools import list_ports

from softgrip_driver.commands.common import BAUDS, DONE, FAILED, add_drive_option, number, parser, run
from softgrip_driver.errors import ConfigurationError, PortLostError
from softgrip_driver.usb_adapter import naming_advice
from softgrip_driver.wizard.drive_setup import DriveSetup, FoundServo, drive_setup
from softgrip_time import Clock

TEXT = """Find servos (Dynamixel, or those of --drive): every serial port (or --port), every baud rate, every ID.
Nothing is written and nothing moves.

Exit code 0 when at least one servo was found, and none shares its ID with another one."""


HEAD = f"{'port':<16}{'baud':>9}{'ID':>5}  {'model':<12}{'number':>6}{'fw':>5}  error"


def line_of(found: FoundServo) -> str:
    """Return the row of the table of a servo that answered."""
    error = "no answer" if found.error is None else (found.error.name or "none")
    error = "several servos with this ID" if found.is_shared else error
    return (
        f"{found.port:<16}{found.baud:>9}{found.servo_id:>5}  {found.name:<12}{found.number:>6}{found.firmware:>5}  "
        f"{error}"
    )


def scan_port(
    setup: DriveSetup, port: str, bauds: Sequence[int], wait: float, clock: Clock | None = None
) -> Iterator[FoundServo]:
    """Yield the servos of one port; raises PortLostError when it cannot be opened."""
    for baud in bauds:
        bus = setup.make_bus(port, baud, 0.02, clock)
        bus.open()
        try:
            yield from setup.find(bus, wait)
        finally:
            bus.close()


#: what to do where no adapter is seen
NO_ADAPTER_REMEDY = (
    "plug its USB cable in (a cable that only charges carries no data), then `ls /dev/serial/by-id` must show it; a "
    "virtual machine or a container must be given it (`docker run --device /dev/ttyUSB0`); or name its port with --port"
)


def _ports(given: str) -> list[str]:
    """Return the ports to look at; says so where no USB adapter is among those of this computer."""
    if given:
        return [given]
    found = sorted(list_ports.comports(), key=lambda port: str(port.device))
    if not any(port.vid is not None for port in found):  # a port of the computer's own has no USB numbers
        own = ", ".join(port.device for port in found)
        print(
            "expected a USB adapter such as a U2D2, found "
            f"{f'only ports of the computer itself ({own})' if own else 'no serial port'}; {NO_ADAPTER_REMEDY}",
            file=sys.stderr,
        )
    return [port.device for port in found]


def work(options: argparse.Namespace) -> int:
    """Scan and print."""
    setup = drive_setup(options.drive)
    ports = _ports(options.port)
    if not ports:
        return FAILED
    if options.baud and options.baud not in setup.bauds:
        raise ConfigurationError(
            f"--baud: expected one of {sorted(setup.bauds)} for drive '{setup.name}', found {options.baud}"
        )
    bauds = [options.baud] if options.baud else setup.bauds
    print(HEAD)
    seen: list[FoundServo] = []
    silent: list[str] = []
    for port in ports:
        before = len(seen)
        try:
            for found in scan_port(setup, port, bauds, options.wait):
                seen.append(found)
                print(line_of(found), flush=True)
            silent += [port] * (len(seen) == before)
        except PortLostError as error:
            print(error, file=sys.stderr)
        if advice := naming_advice(port):
            print(f"{port}: {advice}")
    if silent and not seen:
        print(
            f"no servo answered on {', '.join(silent)}; check power, cable and adapter; {setup.supply_remedy}",
            file=sys.stderr,
        )
    if any(found.is_shared for found in seen):
        print(f"several servos answer to one ID: {setup.shared_id_remedy}", file=sys.stderr)
        return FAILED
    return DONE if seen else FAILED


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("scan", TEXT)
    arguments.add_argument("--port", default="", help="only this port")
    arguments.add_argument("--baud", type=int, choices=sorted(BAUDS), help="only this baud rate")
    add_drive_option(arguments)
    arguments.add_argument(
        "--wait", type=number(0.01, 10.0), default=0.5, metavar="S", help="for answers, default %(default)s s"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
