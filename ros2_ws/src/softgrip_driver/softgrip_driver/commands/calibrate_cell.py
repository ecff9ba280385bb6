# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver calibrate_cell`: counts per newton of a load cell, from known weights."""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from softgrip_driver.commands.common import DONE, FAILED, add_line_options, number, parser, run
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig.build import StreamSettings, make_line_gauge
from softgrip_driver.rig.gauge_calibration import (
    GaugeCalibration,
    WeighedPoint,
    fit_calibration,
    write_calibration,
)
from softgrip_driver.rig.line_gauge import LineGauge
from softgrip_model.friction.laws import GRAVITY

TEXT = """Calibrate a load cell with known weights: counts per newton, offset, linearity and noise, into a file.

Hang the cell as it will pull, and hang each weight on it when asked; the command asks for nothing at first and at the
end, to see whether the zero stays. Write it to a file:

    calibrate_cell --gauge /dev/ttyACM0 --line hx711 --weights 0.2 0.5 1 --file gauge.yaml

Name the file as the gauge's `calibration` in the cell file (docs/cell_file.md)."""

#: share of the largest weight by which line and zero may be off before the command says so
MAX_DEVIATION = 0.005


def ask_person(text: str) -> None:
    """Wait until a person has pressed Enter.

    Raises:
        ConfigurationError: nobody is there to.
    """
    try:
        input(f"{text}, wait until it hangs still, then press Enter: ")
    except EOFError as error:
        raise ConfigurationError("expected somebody who presses Enter, found the input closed") from error


def weigh(
    gauge: LineGauge, masses_kg: Sequence[float], readings: int, ask: Callable[[str], None] = ask_person
) -> list[WeighedPoint]:
    """Return what the gauge shows under each mass [kg], asking for it before.

    Raises:
        DriverError: of the gauge.
    """
    points = []
    for mass in masses_kg:
        ask(f"hang {mass * 1e3:g} g" if mass else "hang nothing")
        shown = [gauge.counts() for _ in range(readings)]
        points.append(WeighedPoint(mass * GRAVITY, statistics.fmean(shown), statistics.stdev(shown), readings))
        print(f"{mass * 1e3:8g} g  {points[-1].mean_counts:14.2f}  +- {points[-1].stddev_counts:.3g}", flush=True)
    return points


def report(found: GaugeCalibration) -> list[str]:
    """Return what was found, and what is not well, in words."""
    lines = [
        f"counts per newton   {found.counts_per_newton:.6g} +- {found.counts_per_newton_stddev:.2g}",
        f"offset              {found.offset_counts:.6g} counts",
        f"linearity           {found.linearity:.3%} of {found.max_force_n:.3g} N",
        f"one reading         +- {found.stddev_n:.3g} N",
        f"drift of the zero   {found.drift_n:+.3g} N",
    ]
    if found.linearity > MAX_DEVIATION:
        lines.append(
            "-> the line is not straight: does something beside the weight touch the cell? are the weights right?"
        )
    if abs(found.drift_n) > MAX_DEVIATION * found.max_force_n:
        lines.append("-> the zero moves: let the cell warm up, screw it down, then calibrate again")
    return lines


def work(options: argparse.Namespace) -> int:
    """Weigh, fit, print, write."""
    if not all(weight > 0.0 for weight in options.weights):
        raise ConfigurationError(f"--weights: expected weights above 0 kg, found {options.weights}")
    # Its scale is what is looked for.
    settings = StreamSettings(options.gauge_baud, options.line, request=options.request)
    gauge = make_line_gauge(options.gauge, settings)
    gauge.open()
    try:
        points = weigh(gauge, [0.0, *options.weights, 0.0], options.readings)
    finally:
        gauge.close()
    found = fit_calibration(points, options.line, options.gauge_baud)
    print("\n".join(report(found)))
    write_calibration(options.file, found)
    print(f"written to {options.file}")
    return DONE if found.linearity <= MAX_DEVIATION else FAILED


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("calibrate_cell", TEXT)
    arguments.add_argument("--gauge", required=True, metavar="PORT", help="serial port of the gauge")
    add_line_options(arguments)
    arguments.add_argument(
        "--weights", type=number(0.0, 100.0), nargs="+", required=True, metavar="KG", help="known weights to hang"
    )
    arguments.add_argument(
        "--readings", type=number(5, 1000, int), default=20, metavar="N", help="for each weight, default %(default)s"
    )
    arguments.add_argument("--file", type=Path, required=True, help="to write")
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
