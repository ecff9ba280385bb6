# SPDX-License-Identifier: Apache-2.0
"""Measured points of cable-on-surface friction, checked."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.friction.errors import DataError
from softgrip_model.friction.laws import Law

Array = NDArray[np.float64]

#: Fewest points that any fit accepts: the Matte law has four coefficients.
MIN_POINTS = 4
#: Below it T1 < T2 is no longer noise of the gauge but swapped columns or a pull in the wrong direction.
LOWEST_RATIO = 0.97
#: No cable on a printed surface comes near it below 90 deg; it is what a T1 in grams gives.
HIGHEST_RATIO = 20.0
#: Spread of T2 that one rig covers; more means that one column mixes units (200 g beside 0.6 kg).
LARGEST_LOAD_SPREAD = 100.0
#: Half of the loads above it [N] are grams under a header that says newtons: the rig hangs 0.2 to 1 kg, and the tendons
#: of a finger break at little more than 100 N.
HIGHEST_LOAD = 150.0


@dataclass(frozen=True, eq=False)
class Measurements:
    """Points (angle, T2, T1), each array of shape (points,).

    Attributes:
        angle: wrap angle [rad].
        tension_low: T2 [N], holding side.
        tension_high: T1 [N], pulled side.
        labels: what to call each point in messages, e.g. "row 7".
        source: file or plan. source_sha256: hash of that source, or of the values where there is no file.
        warnings: what was odd but accepted.
    """

    angle: Array
    tension_low: Array
    tension_high: Array
    labels: tuple[str, ...] = ()
    source: str = "given values"
    source_sha256: str = ""
    warnings: tuple[str, ...] = field(default=())

    @property
    def ratio(self) -> Array:
        """Rf = T1/T2."""
        return self.tension_high / self.tension_low

    def __len__(self) -> int:
        return len(self.angle)

    def subset(self, indices: Sequence[int] | NDArray[np.intp]) -> Measurements:
        """Return some of the points, in the order given; without warnings, which were of the whole."""
        chosen = np.asarray(indices, dtype=np.intp)
        return Measurements(
            self.angle[chosen],
            self.tension_low[chosen],
            self.tension_high[chosen],
            tuple(self.labels[i] for i in chosen),
            self.source,
            self.source_sha256,
        )


def measurements(
    angle: ArrayLike,
    tension_low: ArrayLike,
    tension_high: ArrayLike,
    *,
    labels: Sequence[str] = (),
    source: str = "given values",
    source_sha256: str = "",
) -> Measurements:
    """Check points and return them as one value.

    Args:
        angle: [rad], shape (points,).
        tension_low: T2 [N], shape (points,).
        tension_high: T1 [N], shape (points,).
        labels: names of the points in messages; default "point 1", ...
        source: where they came from.
        source_sha256: its hash; default: of the values.

    Raises:
        DataError: names the first point that cannot be used, and why.
    """
    columns = [np.atleast_1d(np.asarray(c, dtype=np.float64)) for c in (angle, tension_low, tension_high)]
    count = len(columns[0])
    if any(c.shape != (count,) for c in columns):
        raise DataError(f"expected three columns of equal length, found {[c.shape for c in columns]}")
    names = tuple(labels) or tuple(f"point {i + 1}" for i in range(count))
    warnings: list[str] = []
    for name, theta, low, high in zip(names, *columns, strict=True):
        problem = _problem(theta, low, high)
        if problem:
            raise DataError(f"{name}: {problem}")
        if high < low:
            warnings.append(f"{name}: T1 = {high:g} N is below T2 = {low:g} N by less than the gauge's noise; kept")
    if count and columns[1].max() > LARGEST_LOAD_SPREAD * columns[1].min():
        odd = int(np.argmax(np.abs(np.log(columns[1] / np.median(columns[1])))))
        raise DataError(
            f"{names[odd]}: T2 = {columns[1][odd]:g} N beside a median of {np.median(columns[1]):g} N: "
            "expected one unit for all loads; correct the row or the column's unit"
        )
    if count and np.median(columns[1]) > HIGHEST_LOAD:
        raise DataError(
            f"{source}: expected loads T2 below {HIGHEST_LOAD:g} N, found a median of {np.median(columns[1]):g} N; "
            "grams go into a column 'load [g]', T1 has to be in newtons"
        )
    keep = _without_copies(columns, names, warnings)
    digest = source_sha256 or hashlib.sha256(np.stack(columns).tobytes()).hexdigest()
    return Measurements(
        columns[0][keep],
        columns[1][keep],
        columns[2][keep],
        tuple(names[i] for i in keep),
        source,
        digest,
        tuple(warnings),
    )


def check_enough(points: Measurements, law: Law) -> None:
    """Check that a law can be told from these points.

    Raises:
        DataError: too few points, one angle only, or one load only where the law needs the load.
    """
    if len(points) < MIN_POINTS:
        raise DataError(
            f"{points.source}: expected at least {MIN_POINTS} points for the {law} law, found {len(points)}; "
            "measure more angles and loads (nine are recommended: 10, 50, 90 deg x 200, 600, 1000 g)"
        )
    if np.ptp(points.angle) < np.radians(1.0):
        raise DataError(
            f"{points.source}: expected at least two angles, found {np.degrees(points.angle[0]):g} deg only; "
            "add points at another angle: with one, cable and surface friction cannot be told apart"
        )
    if law is not Law.CAPSTAN and points.tension_low.max() < 1.01 * points.tension_low.min():
        raise DataError(
            f"{points.source}: expected at least two loads for the {law} law, found {points.tension_low[0]:g} N only; "
            "add points at another load, or fit the capstan law"
        )


def _problem(angle: float, low: float, high: float) -> str | None:
    if not (np.isfinite(angle) and np.isfinite(low) and np.isfinite(high)):
        return f"expected numbers, found angle {angle:g}, T2 {low:g}, T1 {high:g}; measure the point again or remove it"
    if not 0.0 <= angle <= 2.0 * np.pi:
        return f"expected an angle of 0 .. 360 deg, found {np.degrees(angle):g} deg; check the column's unit"
    if low <= 0.0 or high <= 0.0:
        return f"expected tensions above 0 N, found T2 {low:g} N, T1 {high:g} N; check the gauge's sign and tare"
    ratio = high / low
    if ratio < LOWEST_RATIO:
        return (
            f"expected T1 >= T2 (T1 is the pulled side), found T1 = {high:g} N < T2 = {low:g} N; "
            "check that the columns are not swapped"
        )
    if ratio > HIGHEST_RATIO:
        return f"expected T1/T2 below {HIGHEST_RATIO:g}, found {ratio:g}; check that T1 and T2 are in the same unit"
    return None


def _without_copies(columns: list[Array], names: tuple[str, ...], warnings: list[str]) -> list[int]:
    first: dict[tuple[float, ...], int] = {}
    keep: list[int] = []
    for i, row in enumerate(zip(*columns, strict=True)):
        key = tuple(float(value) for value in row)
        if key in first:
            warnings.append(
                f"{names[i]}: equal to {names[first[key]]} in every value; a copy is no measurement: counted once"
            )
        else:
            first[key] = i
            keep.append(i)
    return keep
