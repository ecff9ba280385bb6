# SPDX-License-Identifier: Apache-2.0
"""What the bench commands share: options of the bus, exit codes, reports of errors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from softgrip_driver.dynamixel.registers import BAUD_CODES
from softgrip_driver.errors import DriverError

#: exit codes
DONE, FAILED = 0, 1


def parser(name: str, text: str) -> argparse.ArgumentParser:
    """Return a parser whose help shows the whole text."""
    return argparse.ArgumentParser(
        prog=f"ros2 run softgrip_driver {name}", description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_bus_options(arguments: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add --port, --baud and --reply-margin."""
    arguments.add_argument("--port", default="", required=required, help="port of the servo bus, e.g. /dev/ttyUSB0")
    arguments.add_argument(
        "--baud", type=int, default=1_000_000, choices=sorted(BAUD_CODES), help="default %(default)s"
    )
    arguments.add_argument(
        "--reply-margin", type=float, default=0.02, metavar="S",
        help="time for a reply beyond that of its bytes, default %(default)s s",
    )  # fmt: skip


def run(
    work: Callable[[argparse.Namespace], int], arguments: argparse.ArgumentParser, args: Sequence[str] | None
) -> int:
    """Parse, work, and tell errors of the driver in one line each."""
    try:
        return work(arguments.parse_args(args))
    except DriverError as error:
        print(error, file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return FAILED
