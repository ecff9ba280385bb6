# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver scan`: which servos answer, on which port, at which baud rate."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from serial.tools import list_ports

from softgrip_driver.commands.common import DONE, FAILED, number, parser, run
from softgrip_driver.dynamixel.adapter import naming_advice
from softgrip_driver.dynamixel.bringup import BOOT_LOADER_REMEDY, SHARED_ID_REMEDY
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import BAUD_CODES, HARDWARE_ERROR, MODEL_NAMES, HardwareError
from softgrip_driver.errors import DriverError, PortLostError
from softgrip_time import Clock

TEXT = """Find Dynamixel servos: every serial port (or --port), every baud rate, every ID.
Nothing is written and nothing moves.

Exit code 0 when at least one servo was found, and none shares its ID with another one."""


@dataclass(frozen=True)
class Found:
    """A servo that answered."""

    port: str
    baud: int
    servo_id: int
    model: int
    firmware: int
    hardware_error: HardwareError | None
    shared: bool

    def line(self) -> str:
        """Return the row of the table."""
        error = "no answer" if self.hardware_error is None else (self.hardware_error.name or "none")
        error = "several servos with this ID" if self.shared else error
        name = MODEL_NAMES.get(self.model, "unknown")
        return f"{self.port:<16}{self.baud:>9}{self.servo_id:>5}  {name:<12}{self.model:>6}{self.firmware:>5}  {error}"


HEAD = f"{'port':<16}{'baud':>9}{'ID':>5}  {'model':<12}{'number':>6}{'fw':>5}  hardware error"


def scan_port(port: str, bauds: Sequence[int], wait: float, clock: Clock | None = None) -> Iterator[Found]:
    """Yield the servos of one port; raises PortLostError when it cannot be opened."""
    for baud in bauds:
        bus = Bus(port, baud, 0.02, clock)
        bus.open()
        try:
            for servo_id, (model, firmware) in sorted(bus.broadcast_ping(wait).items()):
                try:
                    error: HardwareError | None = HardwareError(bus.read(servo_id, HARDWARE_ERROR, attempts=3))
                except PortLostError:
                    raise
                except DriverError:
                    error = None
                yield Found(port, baud, servo_id, model, firmware, error, bus.is_shared(servo_id))
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
    ports = _ports(options.port)
    if not ports:
        return FAILED
    bauds = [options.baud] if options.baud else sorted(BAUD_CODES, key=lambda baud: baud != 57600)
    print(HEAD)
    seen: list[Found] = []
    silent: list[str] = []
    for port in ports:
        before = len(seen)
        try:
            for found in scan_port(port, bauds, options.wait):
                seen.append(found)
                print(found.line(), flush=True)
            silent += [port] * (len(seen) == before)
        except PortLostError as error:
            print(error, file=sys.stderr)
        if advice := naming_advice(port):
            print(f"{port}: {advice}")
    if silent and not seen:
        print(
            f"no servo answered on {', '.join(silent)}; check power, cable and adapter; {BOOT_LOADER_REMEDY}",
            file=sys.stderr,
        )
    if any(found.shared for found in seen):
        print(f"several servos answer to one ID: {SHARED_ID_REMEDY}", file=sys.stderr)
        return FAILED
    return DONE if seen else FAILED


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("scan", TEXT)
    arguments.add_argument("--port", default="", help="only this port")
    arguments.add_argument("--baud", type=int, choices=sorted(BAUD_CODES), help="only this baud rate")
    arguments.add_argument(
        "--wait", type=number(0.01, 10.0), default=0.5, metavar="S", help="for answers, default %(default)s s"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
