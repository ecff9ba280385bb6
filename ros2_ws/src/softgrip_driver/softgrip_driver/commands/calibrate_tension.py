# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver calibrate_tension`: the torque model of a servo, measured against a force gauge."""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from softgrip_driver.commands.common import (
    DONE,
    add_bus_options,
    add_gauge_options,
    number,
    parser,
    run,
    stream_settings,
)
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.errors import ConfigurationError, NoReplyError
from softgrip_driver.rig.build import make_gauge
from softgrip_driver.rig.devices import Gauge
from softgrip_driver.tendon.backend import DriveReading, Setpoint
from softgrip_driver.tendon.units import Spool, TorqueModel, fit_torque_model

TEXT = """Fit the torque model tension = k (current - friction sign(speed)) / radius against a force gauge.

Tie the tendon to the gauge through a spring (a few N/mm). The servo winds in and pays out slowly, several times. It
turns round at --tension of the gauge or of its own estimate, whichever comes first, or after --travel. Ends with the
lines for the parameters of tendon_driver. With --csv a recording (current_a,speed_m_s,tension_n) is fitted instead;
--record writes one."""

PERIOD = 0.05
#: [s] after a turn-round in which friction still turns, and nothing is recorded
TURNING = 0.4


@dataclass(frozen=True)
class TensionSample:
    """One reading of servo and gauge: [A], [m/s], [N]."""

    current: float
    speed: float
    tension: float


def read_csv(path: Path) -> list[TensionSample]:
    """Return the samples of a recording.

    Raises:
        ConfigurationError: no such file, other columns, or no numbers.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [
                TensionSample(float(row["current_a"]), float(row["speed_m_s"]), float(row["tension_n"]))
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise ConfigurationError(
            f"{path}: expected columns current_a, speed_m_s, tension_n with numbers, found: {error!r}"
        ) from error
    for count, row in enumerate(rows, start=1):
        if not all(math.isfinite(value) for value in (row.current, row.speed, row.tension)):
            raise ConfigurationError(f"{path}: expected numbers in every row, found {row} in row {count}; leave it out")
    return rows


def write_csv(path: Path, samples: Sequence[TensionSample]) -> None:
    """Write a recording; raises ConfigurationError where that cannot be done."""
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(("current_a", "speed_m_s", "tension_n"))
            writer.writerows((s.current, s.speed, s.tension) for s in samples)
    except OSError as error:
        raise _unwritable(path, error) from error


def check_writable(path: Path) -> None:
    """Raise ConfigurationError unless a file can be written there; what it holds stays."""
    try:
        path.open("a", encoding="utf-8").close()
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(f"{path}: expected a file that can be written, found: {error}; choose another --record")


def measure(
    backend: DynamixelBackend, gauge: Gauge, tension: float, travel: float, speed: float, rounds: int
) -> list[TensionSample]:
    """Wind in and pay out ``rounds`` times and return what was seen while moving steadily.

    Raises:
        DriverError: of servo or gauge; the servo is let go on every path.
    """
    (name,) = backend.tendons
    samples: list[TensionSample] = []
    backend.power(name, True)
    try:
        start = goal = _reading(backend).position
        for turn in range(2 * rounds):
            inward = turn % 2 == 0
            turned_at = time.monotonic()
            while True:
                began = time.monotonic()
                goal += (speed if inward else -speed) * PERIOD
                backend.write({name: Setpoint(goal, 1.2 * tension)})
                reading, force = _reading(backend), gauge.tension()
                if began - turned_at > TURNING and abs(reading.velocity) > 0.3 * speed:
                    samples.append(TensionSample(reading.current, reading.velocity, force))
                if inward and (max(force, reading.tension) >= tension or goal - start >= travel):
                    break
                if not inward and goal <= start:
                    break
                _until(backend, began + PERIOD)
            print(f"round {turn // 2 + 1}/{rounds} {'in ' if inward else 'out'}: {force:.2f} N, {len(samples)} samples")
    finally:
        backend.power(name, False)
    return samples


def _reading(backend: DynamixelBackend) -> DriveReading:
    (name,) = backend.tendons
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        reading = backend.read().get(name)
        if reading is not None:
            return reading
    raise NoReplyError(f"tendon '{name}': expected a reading within 1 s, found none; check cable and supply")


def _until(backend: DynamixelBackend, due: float) -> None:
    """Keep the servo's bus watchdog fed until it is time."""
    while time.monotonic() < due:
        backend.read()


def _measured(options: argparse.Namespace) -> list[TensionSample]:
    """Measure with the servo and the gauge that the options name."""
    if not (options.port and options.gauge):
        raise ConfigurationError("expected --port and --gauge, or --csv, found neither; see --help")
    if options.record:
        check_writable(options.record)
    model = MODELS[options.model]
    torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
    servo = ServoConfiguration("tendon", options.id, model, Spool(options.radius, options.direction), torque)
    bus = Bus(options.port, options.baud, options.reply_margin)
    backend = DynamixelBackend(bus, [servo], watchdog=0.5, report=print)
    gauge = make_gauge(options.gauge_kind, options.gauge, stream_settings(options))
    gauge.open()
    try:
        backend.connect()
        gauge.tare()
        return measure(backend, gauge, options.tension, options.travel, options.speed, options.rounds)
    finally:
        backend.disconnect()
        gauge.close()


def work(options: argparse.Namespace) -> int:
    """Measure or read, fit, print."""
    samples = read_csv(options.csv) if options.csv else _measured(options)
    try:
        fitted = fit_torque_model(
            [s.current for s in samples],
            [s.speed for s in samples],
            [s.tension for s in samples],
            options.radius,
            str(options.csv or "force gauge"),
        )
        print(f"# {len(samples)} samples; data sheet: {MODELS[options.model].torque_per_ampere:.4f} N m/A")
        print(f"torque_per_ampere_nm_a: [{fitted.torque_per_ampere:.5f}]")
        print(f"friction_currents_a: [{fitted.friction_current:.5f}]")
        print(f"tension_stddev_share: [{fitted.relative_stddev:.4f}]")
    finally:
        # Also what shows no model is worth a look, and a full disk costs the recording alone.
        if options.record:
            write_csv(options.record, samples)
    return DONE


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("calibrate_tension", TEXT)
    add_bus_options(arguments, required=False)
    arguments.add_argument(
        "--id", type=number(0, 252, int), default=1, metavar="0..252", help="servo ID, default %(default)s"
    )
    arguments.add_argument("--model", choices=sorted(MODELS), default="XL330-M288", help="default %(default)s")
    arguments.add_argument(
        "--radius", type=number(1e-3, 0.1), default=0.010, metavar="M", help="spool radius, default %(default)s m"
    )
    arguments.add_argument("--direction", type=int, choices=(-1, 1), default=1, help="+1: positive rotation pulls")
    add_gauge_options(arguments)
    arguments.add_argument(
        "--tension", type=number(0.1, 500.0), default=15.0, metavar="N", help="turn round at, default %(default)s N"
    )
    arguments.add_argument(
        "--travel", type=number(1e-3, 0.5), default=0.02, metavar="M", help="wind in at most, default %(default)s m"
    )
    arguments.add_argument(
        "--speed", type=number(5e-4, 0.1), default=0.003, metavar="M/S", help="default %(default)s m/s"
    )
    arguments.add_argument(
        "--rounds", type=number(1, 100, int), default=3, metavar="N", help="in and out, default %(default)s"
    )
    arguments.add_argument("--csv", type=Path, help="fit a recording instead of measuring")
    arguments.add_argument("--record", type=Path, help="write the samples to this file")
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
