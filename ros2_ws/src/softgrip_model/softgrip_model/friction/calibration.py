# SPDX-License-Identifier: Apache-2.0
"""From measured points to a friction model that can be kept: fit, assessment, record."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from softgrip_model.friction.assess import AcceptanceLimits, Assessment, assess
from softgrip_model.friction.fit import Fit, Loss, fit
from softgrip_model.friction.laws import KReading, Law
from softgrip_model.friction.measurements import Measurements
from softgrip_model.friction.record import FrictionModel, model_id


@dataclass(frozen=True)
class SurfacePair:
    """What slides over what.

    Attributes:
        cable, surface: names. cable_radius_m, surface_radius_m: their radii [m]; the law's r is the sum.
    """

    cable: str
    surface: str
    cable_radius_m: float
    surface_radius_m: float

    @property
    def radius_mm(self) -> float:
        """R of the law [mm]."""
        return 1e3 * (self.cable_radius_m + self.surface_radius_m)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fit with what was found about it, and the model to keep."""

    fit: Fit
    assessment: Assessment
    model: FrictionModel


def calibrate(
    points: Measurements,
    pair: SurfacePair,
    law: Law = Law.MATTE,
    *,
    k_reading: KReading = KReading.PRINTED,
    loss: Loss = Loss.RELATIVE,
    limits: AcceptanceLimits | None = None,
    common_stddev: float = 0.0,
    fitted_at: datetime | None = None,
) -> Calibration:
    """Fit, judge and record.

    Args:
        points: at least four.
        pair: cable and surface.
        law: which.
        k_reading: reading of K in Eq 3.8.
        loss: residuals of ln Rf or of Rf.
        limits: what a usable model must keep.
        common_stddev: relative error that all points share [1] (gauge gain, guide pulley); no scatter shows it, so
            it is added to the covariance.
        fitted_at: default now.

    Raises:
        DataError: the points cannot carry a fit.
        LawError: the radii are not positive.
    """
    found = _with_common_error(
        fit(points, law, radius_mm=pair.radius_mm, k_reading=k_reading, loss=loss), common_stddev
    )
    judged = assess(found, limits)
    when = (fitted_at or datetime.now(UTC)).astimezone(UTC).replace(microsecond=0)
    model = FrictionModel(
        id=model_id(pair.cable, pair.surface, law, when),
        law=found.law,
        covariance=found.covariance,
        residual_stddev=found.residual_stddev,
        average_error=found.average_error,
        maximum_error=found.maximum_error,
        r_squared=found.r_squared if math.isfinite(found.r_squared) else math.nan,
        points=len(points),
        cable=pair.cable,
        surface=pair.surface,
        cable_radius_m=pair.cable_radius_m,
        surface_radius_m=pair.surface_radius_m,
        source=points.source,
        source_sha256=points.source_sha256,
        fitted_at=when,
        verdict=judged.verdict,
        reason=judged.reason,
        degrees_of_freedom=max(found.degrees_of_freedom, 0),
        notes=points.warnings,
    )
    return Calibration(found, judged, model)


def _with_common_error(found: Fit, common_stddev: float) -> Fit:
    """Add what shifts all ln Rf together: the coefficients answer it by J^+ 1 (for the Matte law, by epsilon alone)."""
    if found.covariance is None or common_stddev == 0.0:
        return found
    answer = np.linalg.lstsq(found.slopes, np.ones(len(found.points)), rcond=None)[0]
    return dataclasses.replace(found, covariance=found.covariance + common_stddev**2 * np.outer(answer, answer))
