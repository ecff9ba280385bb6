# SPDX-License-Identifier: Apache-2.0
"""What the bench commands share: options of bus and gauge, exit codes, reports of errors."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from softgrip_driver.dynamixel.registers import BAUD_CODES
from softgrip_driver.errors import ConfigurationError, DriverError
from softgrip_driver.feetech.registers import BAUD_CODES as FEETECH_BAUD_CODES
from softgrip_driver.rig.build import GAUGES, StreamSettings
from softgrip_driver.rig.line_format import FORMATS
from softgrip_time import Clock, SimulatedClock, WallClock

#: [1/s] of all buses; each takes some of them
BAUDS = frozenset(BAUD_CODES) | frozenset(FEETECH_BAUD_CODES)
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
    arguments.add_argument("--baud", type=int, default=1_000_000, choices=sorted(BAUDS), help="default %(default)s")
    arguments.add_argument(
        "--reply-margin", type=number(5e-4, 1.0), default=0.02, metavar="S",
        help="time for a reply beyond that of its bytes, default %(default)s s",
    )  # fmt: skip


def add_drive_option(arguments: argparse.ArgumentParser) -> None:
    """Add --drive: whose servos they are."""
    arguments.add_argument(
        "--drive", metavar="NAME", help="dynamixel (default), feetech, or a backend of an installed package"
    )


def add_line_options(arguments: argparse.ArgumentParser) -> None:
    """Add what says how a gauge that speaks in lines is read."""
    arguments.add_argument(
        "--line", default="grams", metavar="FORMAT",
        help=f"{', '.join(FORMATS)}, or a pattern with a group (?P<value>...), default %(default)s",
    )  # fmt: skip
    arguments.add_argument(
        "--gauge-baud", type=number(0, 3_000_000, int), default=0, metavar="BAUD", help="default: the format's own"
    )
    arguments.add_argument(
        "--request", default="", metavar="TEXT", help=r"what asks for a line, as SI\r\n, default: the format's own"
    )


def add_gauge_options(arguments: argparse.ArgumentParser) -> None:
    """Add --gauge, its kind, and for one that speaks in lines how it is read and its scale."""
    arguments.add_argument("--gauge", default="", metavar="PORT", help="serial port of the force gauge")
    arguments.add_argument(
        "--gauge-kind", choices=GAUGES, default="gcl2", help="stream: it speaks in lines; default %(default)s"
    )
    add_line_options(arguments)
    scale = arguments.add_mutually_exclusive_group()
    scale.add_argument(
        "--counts-per-newton", type=number(-1e9, 1e9), default=1.0, metavar="N", help="of a format without unit"
    )
    scale.add_argument("--gauge-calibration", default="", metavar="FILE", help="of calibrate_cell")


def stream_settings(options: argparse.Namespace) -> StreamSettings:
    """Return what the options of `add_gauge_options` say of a gauge that speaks in lines.

    Raises:
        ConfigurationError: a scale of zero.
    """
    if options.counts_per_newton == 0.0:
        raise ConfigurationError("--counts-per-newton: expected another number than 0; calibrate_cell finds it")
    return StreamSettings(
        options.gauge_baud, options.line, options.counts_per_newton, options.request, options.gauge_calibration
    )


def add_lockstep_option(arguments: argparse.ArgumentParser) -> None:
    """Add --lockstep."""
    arguments.add_argument(
        "--lockstep", type=Path, metavar="SOCKET", help="an emulated cell's time (docs/emulator.md), for its bench only"
    )


def clock_of(options: argparse.Namespace) -> Clock:
    """Return the clock that `add_lockstep_option` asks for.

    Raises:
        ConfigurationError: there is no such cell.
    """
    if options.lockstep is None:
        return WallClock()
    try:
        return SimulatedClock(options.lockstep, "bench")
    except OSError as error:
        raise ConfigurationError(f"--lockstep: expected the socket of an emulated cell, found: {error}") from error


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
