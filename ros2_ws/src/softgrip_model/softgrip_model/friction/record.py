# SPDX-License-Identifier: Apache-2.0
"""A fitted friction law with what is needed to judge it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.friction.student import t_quantile

#: What an id may look like; it is also a file name.
ID_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class ModelVerdict(StrEnum):
    """How far to trust a model."""

    USABLE = "usable"
    REPEAT_POINTS = "repeat_points"
    DO_NOT_USE = "do_not_use"


@dataclass(frozen=True, eq=False)
class FrictionModel:
    """A friction law with its uncertainty, its quality and where it came from.

    Attributes:
        id: unique name, also the file's name.
        law: coefficients, radius and calibrated ranges.
        covariance: of the coefficients, shape (p, p); None when unknown (published sets give none).
        residual_stddev: standard deviation of ln Rf about the fit [1]; NaN when unknown.
        average_error: mean |Rf_fit - Rf| / Rf [1]; NaN when unknown. maximum_error: the largest.
        r_squared: 1 - SSE/SST on Rf.
        points: measured points used.
        cable, surface: what slid over what.
        cable_radius_m, surface_radius_m: r of the law is their sum.
        source: file or plan the points came from. source_sha256: its hash, empty for print.
        fitted_at: time of the fit, UTC.
        verdict, reason: may it be used, and why.
        degrees_of_freedom: of residual_stddev; 0 when unknown.
    """

    id: str
    law: FrictionLaw
    covariance: NDArray[np.float64] | None
    residual_stddev: float
    average_error: float
    maximum_error: float
    r_squared: float
    points: int
    cable: str
    surface: str
    cable_radius_m: float
    surface_radius_m: float
    source: str
    source_sha256: str
    fitted_at: datetime
    verdict: ModelVerdict
    reason: str
    degrees_of_freedom: int = 0
    notes: tuple[str, ...] = field(default=())

    def ratio(self, angle: ArrayLike, tension_low: ArrayLike) -> NDArray[np.float64]:
        """Return Rf at wrap angles [rad] and low tensions [N]."""
        return self.law.ratio(angle, tension_low)

    def log_ratio_stddev(self, angle: ArrayLike, tension_low: ArrayLike) -> NDArray[np.float64]:
        """Return the standard deviation of the predicted mean ln Rf; NaN where the covariance is unknown."""
        slopes = self.law.evaluate(angle, tension_low).d_coefficients
        if self.covariance is None:
            return np.full(slopes.shape[:-1], np.nan)
        variance = np.einsum("...i,ij,...j->...", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def interval(
        self, angle: ArrayLike, tension_low: ArrayLike, level: float = 0.95, *, of_one_measurement: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lower and upper ends of the interval of Rf.

        Args:
            angle: [rad].
            tension_low: T2 [N].
            level: coverage.
            of_one_measurement: of a new measured point (adds the residual scatter) instead of the law itself.
        """
        mean = self.law.evaluate(angle, tension_low).log_ratio
        stddev = self.log_ratio_stddev(angle, tension_low)
        if of_one_measurement:
            stddev = np.hypot(stddev, self.residual_stddev)
        freedom = self.degrees_of_freedom if self.degrees_of_freedom > 0 else np.inf
        half = stddev * t_quantile(0.5 + level / 2, freedom)
        return np.exp(mean - half), np.exp(mean + half)

    def age(self, now: datetime) -> float:
        """Return the seconds [s] since the fit."""
        return (now - self.fitted_at).total_seconds()


def model_id(cable: str, surface: str, law: Law, fitted_at: datetime) -> str:
    """Return an id such as ``pe-braid-0.25-mm-tpu-matte-20261121T101500Z``."""
    slug = re.sub(r"[^a-z0-9.]+", "-", f"{cable} {surface}".lower()).strip("-.") or "model"
    return f"{slug[:70]}-{law}-{fitted_at.astimezone(UTC):%Y%m%dT%H%M%SZ}"
