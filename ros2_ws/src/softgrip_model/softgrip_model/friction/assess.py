# SPDX-License-Identifier: Apache-2.0
"""How far to trust a fit: which points hurt, does the law fit at all, and a verdict with reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.fit import Fit
from softgrip_model.friction.laws import Law
from softgrip_model.friction.record import ModelVerdict
from softgrip_model.friction.student import f_tail, t_tail

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AcceptanceLimits:
    """What a usable model must keep.

    Attributes:
        average_error: of the points [1]; Table 3.1's worst is 0.026.
        maximum_error: of one point [1]; Table 3.1's worst is 0.077.
        interval: largest 95 % half width of the law over its range [1].
        significance: of the outlier and lack-of-fit tests.
    """

    average_error: float = 0.05
    maximum_error: float = 0.15
    interval: float = 0.10
    significance: float = 0.01


@dataclass(frozen=True)
class LackOfFit:
    """An F test of the law's shape.

    Attributes:
        method: "replicates" (scatter between points repeated at one angle and load) or "curvature" (does adding squares
            of angle and ln T2 to the law explain more than chance would).
        statistic: F. degrees: of numerator and denominator. p_value: small means the law does not fit.
    """

    method: str
    statistic: float
    degrees: tuple[int, int]
    p_value: float


@dataclass(frozen=True, eq=False)
class Assessment:
    """What was found about a fit; N points.

    Attributes:
        studentised: externally studentised residuals, (N,); NaN without two degrees of freedom.
        cooks_distance: how far the coefficients move without a point, (N,).
        outliers: indices of points that the others contradict.
        influential: indices of points with more than twice the mean leverage.
        lack_of_fit: None where the points cannot tell.
        widest_interval: largest 95 % half width of ln Rf over the calibrated range; NaN when unknown.
        verdict, reasons: may the model be used.
    """

    studentised: Array
    cooks_distance: Array
    outliers: tuple[int, ...]
    influential: tuple[int, ...]
    lack_of_fit: LackOfFit | None
    widest_interval: float
    verdict: ModelVerdict
    reasons: tuple[str, ...]

    @property
    def reason(self) -> str:
        """The reasons as one line."""
        return "; ".join(self.reasons)


def assess(fit: Fit, limits: AcceptanceLimits | None = None) -> Assessment:
    """Judge a fit."""
    limits = limits or AcceptanceLimits()
    studentised, cooks = _influence(fit)
    outliers = _outliers(fit, studentised, limits.significance)
    lack = lack_of_fit(fit)
    widest = widest_interval(fit)
    verdict, reasons = _verdict(fit, limits, outliers, lack, widest)
    influential = np.flatnonzero(fit.leverage > 2.0 * len(fit.law.names) / len(fit.points))
    return Assessment(
        studentised, cooks, outliers, tuple(int(i) for i in influential), lack, widest, verdict, tuple(reasons)
    )


def widest_interval(fit: Fit, level: float = 0.95) -> float:
    """Return the largest half width of ln Rf over the calibrated angles and tensions."""
    angles = np.linspace(*fit.law.angle_range, 9)
    tensions = np.geomspace(*fit.law.tension_range, 9)
    return float(np.max(fit.interval_half_width(angles[:, np.newaxis], tensions, level)))


def lack_of_fit(fit: Fit) -> LackOfFit | None:
    """Test the law's shape, with replicates where there are any, else with curvature (a 3 x 3 grid is enough)."""
    return _replicate_test(fit) or _curvature_test(fit)


def _influence(fit: Fit) -> tuple[Array, Array]:
    count, freedom = len(fit.points), fit.degrees_of_freedom
    free = np.maximum(1.0 - fit.leverage, 1e-12)
    if freedom < 2:
        return np.full(count, np.nan), np.full(count, np.nan)
    total = float(fit.residuals @ fit.residuals)
    without = np.maximum(total - fit.residuals**2 / free, 0.0) / (freedom - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        studentised = fit.residuals / np.sqrt(without * free)
        cooks = fit.residuals**2 * fit.leverage / (len(fit.law.names) * total / freedom * free**2)
    return np.nan_to_num(studentised), np.nan_to_num(cooks)


def _outliers(fit: Fit, studentised: Array, significance: float) -> tuple[int, ...]:
    """Bonferroni test: the chance that the worst of N good points looks this bad is below the significance."""
    if fit.degrees_of_freedom < 2:
        return ()

    p_values = 2.0 * t_tail(np.abs(studentised), fit.degrees_of_freedom - 1) * len(fit.points)
    return tuple(int(i) for i in np.flatnonzero(p_values < significance))


def _replicate_test(fit: Fit) -> LackOfFit | None:
    settings = np.stack([np.degrees(fit.points.angle).round(3), fit.points.tension_low.round(6)])
    _, group = np.unique(settings, axis=1, return_inverse=True)
    groups = int(group.max()) + 1
    pure_freedom = len(fit.points) - groups
    lack_freedom = groups - len(fit.law.names)
    if pure_freedom < 2 or lack_freedom < 1:
        return None
    means = np.bincount(group, fit.residuals) / np.bincount(group)
    pure = float(np.sum((fit.residuals - means[group]) ** 2))
    lack = float(fit.residuals @ fit.residuals) - pure
    return _f_test("replicates", lack, lack_freedom, pure, pure_freedom)


def _curvature_test(fit: Fit) -> LackOfFit | None:
    quantities = (fit.points.angle, np.log(fit.points.tension_low))
    columns = [(q - q.mean()) ** 2 for q in quantities if len(np.unique(q.round(6))) >= 3]
    freedom = fit.degrees_of_freedom - len(columns)
    if not columns or freedom < 2:
        return None
    extra = np.stack(columns, axis=1)
    base = np.linalg.qr(fit.slopes / np.maximum(np.linalg.norm(fit.slopes, axis=0), 1e-300))[0]
    extra -= base @ (base.T @ extra)
    explained = np.linalg.qr(extra)[0].T @ fit.residuals
    lack = float(explained @ explained)
    rest = float(fit.residuals @ fit.residuals) - lack
    return _f_test("curvature", lack, len(columns), rest, freedom)


def _f_test(method: str, lack: float, lack_freedom: int, rest: float, rest_freedom: int) -> LackOfFit | None:
    if rest <= 0.0:
        return None
    statistic = max(lack, 0.0) / lack_freedom / (rest / rest_freedom)
    return LackOfFit(method, statistic, (lack_freedom, rest_freedom), f_tail(statistic, (lack_freedom, rest_freedom)))


def _verdict(
    fit: Fit, limits: AcceptanceLimits, outliers: tuple[int, ...], lack: LackOfFit | None, widest: float
) -> tuple[ModelVerdict, list[str]]:
    refusals = _refusals(fit, limits, widest)
    repeats = [f"repeat {fit.points.labels[i]}: the other points contradict it" for i in outliers]
    # Where the average is bad too, it is the law and not one point.
    if limits.maximum_error < fit.maximum_error and fit.average_error <= limits.average_error and not outliers:
        worst = int(np.argmax(np.abs(fit.residuals)))
        repeats.append(
            f"repeat {fit.points.labels[worst]}: error {fit.maximum_error:.1%} (limit {limits.maximum_error:.0%})"
        )
    if lack is not None and lack.p_value < limits.significance and fit.average_error > 0.5 * limits.average_error:
        refusals.append(f"the law's shape does not fit ({lack.method} test, p = {lack.p_value:.4f})")
    # One bad point can spoil every measure above: while there is one to repeat, that comes first.
    if repeats and math.isfinite(widest):
        return ModelVerdict.REPEAT_POINTS, repeats + refusals
    if refusals:
        return ModelVerdict.DO_NOT_USE, refusals + repeats
    text = f"average error {fit.average_error:.1%}, 95 % interval within {widest:.1%} over the calibrated range"
    return ModelVerdict.USABLE, [text]


def _refusals(fit: Fit, limits: AcceptanceLimits, widest: float) -> list[str]:
    reasons = []
    if fit.degrees_of_freedom < 1 and fit.covariance is None:
        reasons.append(
            f"{len(fit.points)} points leave no degree of freedom for {len(fit.law.names)} coefficients: "
            "the error is unknown; measure at least one more point"
        )
    elif fit.covariance is None:
        vanishing = fit.law.vanishing_tension
        inside = fit.law.law is Law.MATTE and vanishing < fit.law.tension_range[1]
        simpler = (
            f": the surface term vanishes at {vanishing:.1f} N; add lower loads or try the heap law" if inside else ""
        )
        reasons.append(f"the coefficients cannot be told apart from these points{simpler}")
    if not fit.converged:
        reasons.append("the fit did not converge")
    if fit.average_error > limits.average_error:
        reasons.append(f"average error {fit.average_error:.1%} above the limit of {limits.average_error:.0%}")
    if widest > limits.interval:
        reasons.append(
            f"the 95 % interval reaches {widest:.1%} (limit {limits.interval:.0%}); "
            "measure more points or repeat noisy ones"
        )
    blow_up = fit.law.blow_up_angle(fit.law.tension_range[0])
    if blow_up < 2.0 * fit.law.angle_range[1]:
        reasons.append(f"the law blows up at {math.degrees(blow_up):.0f} deg, within twice the calibrated angles")
    return reasons
