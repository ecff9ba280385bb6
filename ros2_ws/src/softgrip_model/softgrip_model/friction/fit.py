# SPDX-License-Identifier: Apache-2.0
"""Fit of a friction law to measured points, with covariance and the thesis' error measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.friction import _core
from softgrip_model.friction.errors import DataError
from softgrip_model.friction.laws import COEFFICIENT_NAMES, FrictionLaw, KReading, Law, k_index, law_index
from softgrip_model.friction.measurements import Measurements, check_enough
from softgrip_model.friction.student import t_quantile

Array = NDArray[np.float64]

#: Where coefficients may lie; n as in the thesis' laws, the others wide around every cable measured so far.
BOUNDS: dict[str, tuple[float, float]] = {
    "mu": (0.0, 5.0),
    "alpha": (0.0, 3.0),
    "n": (1e-3, 0.999),
    "epsilon": (-1.0, 2.0),
    "lambda": (-0.5, 0.5),
}
#: Condition number of the scaled Jacobian above which coefficients cannot be told apart (45 points give 25-61).
WORST_CONDITION = 1e6


class Loss(StrEnum):
    """RELATIVE: residuals of ln Rf, so that every point counts by its relative error. ABSOLUTE: residuals of Rf."""

    RELATIVE = "relative"
    ABSOLUTE = "absolute"


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found; N points, p coefficients.

    Attributes:
        law: the law, with the calibrated ranges of the points.
        points: what it was fitted to.
        covariance: of the coefficients, (p, p); None when they cannot be told apart or the scatter is unknown.
        residual_stddev: of ln Rf about the fit [1]; NaN without a degree of freedom and without a given noise.
        degrees_of_freedom: N - p.
        residuals: ln Rf measured - ln Rf fitted, (N,).
        leverage: diagonal of the hat matrix, (N,), sums to p.
        slopes: d ln Rf / d coefficient at the points, (N, p).
        average_error, maximum_error: of |Rf_fit - Rf| / Rf. r_squared: 1 - SSE/SST on Rf (thesis Table 3.1).
        cost: half the sum of squared residuals of the loss.
        condition: of the column-scaled Jacobian.
        at_bound: names of coefficients that ended on a bound.
        converged: the winning start met its tolerance.
    """

    law: FrictionLaw
    points: Measurements
    covariance: Array | None
    residual_stddev: float
    degrees_of_freedom: int
    residuals: Array
    leverage: Array
    slopes: Array
    average_error: float
    maximum_error: float
    r_squared: float
    cost: float
    condition: float
    at_bound: tuple[str, ...]
    converged: bool

    def interval_half_width(
        self, angle: ArrayLike, tension_low: ArrayLike, level: float = 0.95, *, of_one_measurement: bool = False
    ) -> Array:
        """Return the half width of the interval of ln Rf (about the relative half width of Rf); NaN when unknown.

        Args:
            angle: [rad].
            tension_low: T2 [N].
            level: coverage.
            of_one_measurement: of a new measured point instead of the law itself.
        """
        slopes = self.law.evaluate(angle, tension_low).d_coefficients
        if self.covariance is None:
            return np.full(slopes.shape[:-1], np.nan)
        variance = np.maximum(np.einsum("...i,ij,...j->...", slopes, self.covariance, slopes), 0.0)
        if of_one_measurement:
            variance = variance + self.residual_stddev**2
        freedom = self.degrees_of_freedom if self.degrees_of_freedom > 0 else math.inf
        return np.asarray(np.sqrt(variance) * t_quantile(0.5 + level / 2, freedom))


def fit(
    points: Measurements,
    law: Law = Law.MATTE,
    *,
    radius_mm: float,
    k_reading: KReading = KReading.PRINTED,
    loss: Loss = Loss.RELATIVE,
    noise_stddev: float | None = None,
    start: tuple[float, ...] | None = None,
) -> Fit:
    """Fit a law by bounded least squares, from a ladder of starts.

    Args:
        points: at least four.
        law: which.
        radius_mm: r = r_cable + r_surface [mm].
        k_reading: reading of K.
        loss: residuals of ln Rf or of Rf.
        noise_stddev: known relative noise of one point [1]; used for the covariance instead of the scatter, and the
            only way to have one with as many points as coefficients.
        start: use this start alone (coefficients in order) instead of the ladder.

    Raises:
        DataError: too few points, too few angles or loads, or a start at which the law has no value.
    """
    check_enough(points, law)
    names = COEFFICIENT_NAMES[law]
    lower, upper = (_padded([BOUNDS[name][end] for name in names]) for end in (0, 1))
    coefficients, cost, _, converged = _core.fit(
        law_index(law),
        k_index(k_reading),
        radius_mm,
        points.angle,
        points.tension_low,
        points.ratio,
        np.ones(len(points)),
        0 if loss is Loss.RELATIVE else 1,
        lower,
        upper,
        None if start is None else _padded(list(start)),
    )
    if not math.isfinite(cost):
        raise DataError(
            f"{points.source}: expected a start at which the {law} law has a value at every point, found none; "
            "start nearer to the published coefficients, or check the radius"
        )
    fitted = FrictionLaw(
        law,
        tuple(coefficients),
        radius_mm,
        k_reading,
        (float(points.angle.min()), float(points.angle.max())),
        (float(points.tension_low.min()), float(points.tension_low.max())),
    )
    at_bound = tuple(n for n, c in zip(names, coefficients, strict=True) if c in BOUNDS[n])
    return _described(fitted, points, loss, noise_stddev, cost, converged=converged, at_bound=at_bound)


def capstan_per_load(points: Measurements) -> tuple[Array, Array]:
    """Fit Eq 3.7 with its own mu for every load, as Table 3.1 does.

    Returns:
        the loads T2 [N] and their mu, both of shape (loads,).
    """
    loads = np.unique(points.tension_low)
    mu = np.array(
        [
            float(points.angle[here] @ np.log(points.ratio[here]) / (points.angle[here] @ points.angle[here]))
            for here in (points.tension_low == load for load in loads)
        ]
    )
    return loads, mu


def errors(predicted: ArrayLike, measured: ArrayLike) -> tuple[float, float, float]:
    """Return (average error, maximum error, R2) of ratios as Table 3.1 defines them."""
    fitted, real = np.asarray(predicted, dtype=np.float64), np.asarray(measured, dtype=np.float64)
    relative = np.abs(fitted - real) / real
    spread = float(np.sum((real - real.mean()) ** 2))
    r_squared = 1.0 - float(np.sum((fitted - real) ** 2)) / spread if spread > 0.0 else math.nan
    return float(relative.mean()), float(relative.max()), r_squared


def _described(
    law: FrictionLaw,
    points: Measurements,
    loss: Loss,
    noise_stddev: float | None,
    cost: float,
    *,
    converged: bool,
    at_bound: tuple[str, ...],
) -> Fit:
    value = law.evaluate(points.angle, points.tension_low)
    residuals = np.log(points.ratio) - value.log_ratio
    freedom = len(points) - len(law.names)
    scatter = math.sqrt(float(residuals @ residuals) / freedom) if freedom > 0 else math.nan
    stddev = scatter if noise_stddev is None else noise_stddev
    gain = value.ratio[:, np.newaxis] if loss is Loss.ABSOLUTE else 1.0
    jacobian = value.d_coefficients * gain
    scale = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(scale > 0.0, scale, 1.0)
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else math.inf
    covariance = None
    if condition < WORST_CONDITION and math.isfinite(stddev):
        unit = stddev if loss is Loss.RELATIVE or noise_stddev is not None else math.sqrt(2.0 * cost / freedom)
        root = right.T / singular / scale[:, np.newaxis]
        covariance = unit**2 * root @ root.T
    average, maximum, r_squared = errors(value.ratio, points.ratio)
    return Fit(
        law=law,
        points=points,
        covariance=covariance,
        residual_stddev=stddev,
        degrees_of_freedom=freedom,
        residuals=residuals,
        leverage=np.sum(left**2, axis=1),
        slopes=value.d_coefficients,
        average_error=average,
        maximum_error=maximum,
        r_squared=r_squared,
        cost=cost,
        condition=condition,
        at_bound=at_bound,
        converged=converged,
    )


def _padded(values: list[float]) -> list[float]:
    return values + [0.0] * (4 - len(values))
