# SPDX-License-Identifier: Apache-2.0
"""What the bench commands share: options of the bus, exit codes, reports of errors."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from softgrip_driver.dynamixel.registers import BAUD_CODES
from softgrip_driver.errors import DriverError

#: exit codes
DONE, FAILED = 0, 1
#: what ends a command: Ctrl-C, kill, the terminal closed
_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def parser(name: str, text: str) -> argparse.ArgumentParser:
    """Return a parser whose help shows the whole text."""
    return argparse.ArgumentParser(
        prog=f"ros2 run softgrip_driver {name}", description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def number(low: float, high: float, kind: type[float | int] = float) -> Callable[[str], float]:
    """Return what turns an option's text into a number from ``low`` to ``high``; argparse tells what is wrong."""

    def convert(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            name = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"expected {name} from {low:g} to {high:g}, found '{text}'")
        return value

    return convert


def add_bus_options(arguments: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add --port, --baud and --reply-margin."""
    arguments.add_argument("--port", default="", required=required, help="port of the servo bus, e.g. /dev/ttyUSB0")
    arguments.add_argument(
        "--baud", type=int, default=1_000_000, choices=sorted(BAUD_CODES), help="default %(default)s"
    )
    arguments.add_argument(
        "--reply-margin", type=number(5e-4, 1.0), default=0.02, metavar="S",
        help="time for a reply beyond that of its bytes, default %(default)s s",
    )  # fmt: skip


def run(
    work: Callable[[argparse.Namespace], int], arguments: argparse.ArgumentParser, args: Sequence[str] | None
) -> int:
    """Parse, work, and tell errors of the driver in one line each. However it is ended, work leaves things safe."""
    options = arguments.parse_args(args)
    try:
        with _ended_once():
            return work(options)
    except DriverError as error:
        print(error, file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return FAILED


@contextmanager
def _ended_once() -> Iterator[None]:
    """Make each signal that ends a program a KeyboardInterrupt, so that work cleans up; no second one cuts in."""

    def end(_signal: int, _frame: object) -> NoReturn:
        for one in _ENDS:
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt

    # Under nohup a closed terminal ends nothing.
    before = {one: signal.signal(one, end) for one in _ENDS if signal.getsignal(one) is not signal.SIG_IGN}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
