# SPDX-License-Identifier: Apache-2.0
"""Recordings of calibrate_tension: readings of a servo beside the tension of a gauge or weight, as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.winding import MotorReading


@dataclass(frozen=True)
class TensionSample:
    """One reading of servo and gauge. Older recordings lack the last three: NaN.

    Attributes:
        current_a: Present Current [A].
        speed_m_s: of the tendon.
        tension_n: of the gauge or weight.
        duty: Present PWM, -1 .. 1.
        voltage_v, temperature_degc: as the servo says.
    """

    current_a: float
    speed_m_s: float
    tension_n: float
    duty: float = math.nan
    voltage_v: float = math.nan
    temperature_degc: float = math.nan

    def motor(self, radius_m: float) -> MotorReading:
        """Return the motor's reading behind a spool of this radius."""
        return MotorReading(self.current_a, self.duty, self.speed_m_s / radius_m, self.voltage_v, self.temperature_degc)


COLUMNS = tuple(field.name for field in fields(TensionSample))
REQUIRED_COLUMNS = COLUMNS[:3]


def read_csv(path: Path) -> list[TensionSample]:
    """Return the samples of a recording.

    Raises:
        ConfigurationError: no such file, other columns, or no numbers.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [_sample(row) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise ConfigurationError(
            f"{path}: expected columns {', '.join(REQUIRED_COLUMNS)} with numbers, found: {error!r}"
        ) from error
    for count, row in enumerate(rows, start=1):
        if not all(math.isfinite(getattr(row, name)) for name in REQUIRED_COLUMNS):
            raise ConfigurationError(f"{path}: expected numbers in every row, found {row} in row {count}; leave it out")
    return rows


def _sample(row: Mapping[str, str]) -> TensionSample:
    """Return the sample of a row; the columns of the motor are all there or none."""
    names = COLUMNS if "duty" in row else REQUIRED_COLUMNS
    return TensionSample(*(float(row[name]) for name in names))


def write_csv(path: Path, samples: Sequence[TensionSample]) -> None:
    """Write a recording.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows([getattr(sample, name) for name in COLUMNS] for sample in samples)
    except OSError as error:
        raise _unwritable(path, error) from error


def check_writable(path: Path) -> None:
    """Open a file for writing and leave what it holds: before a measurement, not after it.

    Raises:
        ConfigurationError: it cannot be written.
    """
    try:
        path.open("a", encoding="utf-8").close()
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(f"{path}: expected a file that can be written, found: {error}; choose another --record")
