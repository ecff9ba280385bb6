# SPDX-License-Identifier: Apache-2.0
"""A load cell against known weights: counts per newton, offset, linearity, noise; and the file that keeps them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import yaml

from softgrip_driver.errors import ConfigurationError
from softgrip_model.durable import replacing_durably

SCHEMA = 1
#: The largest weight must move the reading by so many standard deviations of a reading: a cut cell shows noise.
MIN_SIGNAL = 10.0


@dataclass(frozen=True)
class WeighedPoint:
    """Readings under one known weight.

    Attributes:
        force_n: of the weight [N]. mean_counts: of the readings. stddev_counts: of one reading. readings: how many.
    """

    force_n: float
    mean_counts: float
    stddev_counts: float
    readings: int


@dataclass(frozen=True)
class GaugeCalibration:
    """What known weights say of a gauge.

    Attributes:
        counts_per_newton: sign included. counts_per_newton_stddev: of it.
        offset_counts: with nothing hung.
        linearity: largest deviation from the straight line over the range of the weights [1].
        stddev_n: of one reading [N].
        drift_n: of the zero between the first and the last weighing [N].
        max_force_n: largest weight [N].
        line, baud: how the gauge was read; baud 0: its format's own.
        date: UTC.
    """

    counts_per_newton: float
    counts_per_newton_stddev: float
    offset_counts: float
    linearity: float
    stddev_n: float
    drift_n: float
    max_force_n: float
    line: str
    baud: int
    date: str


def fit_calibration(points: Sequence[WeighedPoint], line: str, baud: int) -> GaugeCalibration:
    """Fit counts = offset + counts_per_newton force by least squares.

    Args:
        points: in the order they were weighed, the first and the last without a weight.
        line: how the gauge was read.
        baud: [1/s] likewise.

    Raises:
        ConfigurationError: fewer than two different weights, or readings that do not follow them.
    """
    force = np.array([p.force_n for p in points])
    counts = np.array([p.mean_counts for p in points])
    if len(points) < 3 or points[0].force_n or points[-1].force_n or not np.ptp(force) > 0.0:
        raise ConfigurationError("expected at least one weight, weighed between two zeros, found none; see --weights")
    noise = math.sqrt(float(np.mean([p.stddev_counts**2 for p in points])))
    design = np.column_stack([np.ones_like(force), force])
    (offset, slope), *_ = np.linalg.lstsq(design, counts, rcond=None)
    residual = counts - design @ (offset, slope)
    if abs(slope) * np.ptp(force) <= max(MIN_SIGNAL * noise, 2.0 * float(np.abs(residual).max())):
        raise ConfigurationError(
            f"expected readings that follow the weights, found {counts.min():g} to {counts.max():g} with a noise of "
            f"{noise:.3g} and no line through them; check the cell's four wires and that the weights hang on it"
        )
    # What the line leaves, and what averaging left of the noise: whichever is larger.
    averaged = noise / math.sqrt(min(p.readings for p in points))
    spread = math.sqrt(float(residual @ residual) / max(len(points) - 2, 1))
    slope_stddev = max(spread, averaged) / math.sqrt(float(((force - force.mean()) ** 2).sum()))
    return GaugeCalibration(
        counts_per_newton=float(slope),
        counts_per_newton_stddev=slope_stddev,
        offset_counts=float(offset),
        linearity=float(np.abs(residual).max() / (abs(slope) * np.ptp(force))),
        stddev_n=float(noise / abs(slope)),
        drift_n=float((counts[-1] - counts[0]) / slope),
        max_force_n=float(force.max()),
        line=line,
        baud=baud,
        date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )


def write_calibration(path: Path, found: GaugeCalibration) -> None:
    """Write the file.

    Raises:
        ConfigurationError: it can not be written.
    """
    text = (
        "# Load cell against known weights (ros2 run softgrip_driver calibrate_cell); give it as gauge_calibration.\n"
    )
    try:
        with replacing_durably(path) as stream:
            stream.write((text + yaml.safe_dump({"schema": SCHEMA, **asdict(found)}, sort_keys=False)).encode())
    except OSError as error:
        raise ConfigurationError(f"{path}: expected a file that can be written, found: {error}") from error


def read_calibration(path: Path) -> GaugeCalibration:
    """Read the file.

    Raises:
        ConfigurationError: it can not be read, or holds something else.
    """
    kinds = {"line": str, "baud": int, "date": str}
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema {document['schema']}")
        found = GaugeCalibration(
            **{field.name: kinds.get(field.name, float)(document[field.name]) for field in fields(GaugeCalibration)}
        )
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"{path}: expected a file of calibrate_cell (schema {SCHEMA}), found: {error!r}; calibrate the cell again"
        ) from error
    if (
        not math.isfinite(found.counts_per_newton)
        or found.counts_per_newton == 0.0
        or not math.isfinite(found.offset_counts)
    ):
        raise ConfigurationError(
            f"{path}: expected counts per newton other than 0 and a finite offset, found {found.counts_per_newton:g} "
            f"and {found.offset_counts:g}; calibrate the cell again"
        )
    return found
