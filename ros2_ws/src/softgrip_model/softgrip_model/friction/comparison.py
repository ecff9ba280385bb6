# SPDX-License-Identifier: Apache-2.0
"""What a fit loses when it is made from few of the points: nine against forty-five (thesis, section 3.3.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.errors import DataError
from softgrip_model.friction.fit import Fit, errors, fit
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_model.friction.measurements import Measurements


@dataclass(frozen=True, eq=False)
class Comparison:
    """A fit to some points, judged on all of them; errors as in Table 3.3.

    Attributes:
        few: fit to the chosen points. full: fit to all.
        chosen: indices of the points used.
        average_error, maximum_error, r_squared: of `few` on all points.
    """

    few: Fit
    full: Fit
    chosen: NDArray[np.intp]
    average_error: float
    maximum_error: float
    r_squared: float


def spread_points(points: Measurements, count: int = 9) -> NDArray[np.intp]:
    """Return the indices of ``count`` points nearest to an even grid of lowest, middle and highest angles and loads.

    For nine points of the thesis' 45 these are 10, 50, 90 deg x 200, 600, 1000 g.

    Raises:
        DataError: not a square number of points, or fewer points than asked for.
    """
    side = round(count**0.5)
    if side * side != count or side < 2 or count > len(points):
        raise DataError(f"expected 4, 9, 16, ... points, at most the {len(points)} measured, found {count}")
    angles = _normalised(points.angle)
    loads = _normalised(points.tension_low)
    free = np.ones(len(points), dtype=bool)
    chosen = []
    for angle in np.linspace(0.0, 1.0, side):
        for load in np.linspace(0.0, 1.0, side):
            distance = np.where(free, np.hypot(angles - angle, loads - load), np.inf)
            best = int(np.argmin(distance))
            free[best] = False
            chosen.append(best)
    return np.array(chosen, dtype=np.intp)


def compare(
    points: Measurements,
    law: Law = Law.MATTE,
    *,
    radius_mm: float,
    count: int = 9,
    k_reading: KReading = KReading.PRINTED,
) -> Comparison:
    """Fit to ``count`` spread points and to all, and judge both on all.

    Raises:
        DataError: the points do not carry it.
    """
    chosen = spread_points(points, count)
    few = fit(points.subset(chosen), law, radius_mm=radius_mm, k_reading=k_reading)
    full = fit(points, law, radius_mm=radius_mm, k_reading=k_reading)
    unranged = FrictionLaw(law, few.law.coefficients, radius_mm, k_reading)
    return Comparison(few, full, chosen, *errors(unranged.ratio(points.angle, points.tension_low), points.ratio))


def _normalised(values: NDArray[np.float64]) -> NDArray[np.float64]:
    span = float(np.ptp(values))
    return (values - values.min()) / span if span > 0.0 else np.zeros_like(values)
