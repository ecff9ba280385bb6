# SPDX-License-Identifier: Apache-2.0
"""From measured points to a friction model that can be kept: fit, assessment, record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

from softgrip_model.friction.assess import Assessment, Limits, assess
from softgrip_model.friction.fit import Fit, Loss, fit
from softgrip_model.friction.laws import KReading, Law
from softgrip_model.friction.measurements import Measurements
from softgrip_model.friction.record import FrictionModel, model_id


@dataclass(frozen=True)
class Pair:
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
    pair: Pair,
    law: Law = Law.MATTE,
    *,
    k_reading: KReading = KReading.PRINTED,
    loss: Loss = Loss.RELATIVE,
    limits: Limits | None = None,
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
        fitted_at: default now.

    Raises:
        DataError: the points cannot carry a fit.
        LawError: the radii are not positive.
    """
    found = fit(points, law, radius_mm=pair.radius_mm, k_reading=k_reading, loss=loss)
    judged = assess(found, limits)
    when = (fitted_at or datetime.now(UTC)).astimezone(UTC).replace(microsecond=0)
    model = FrictionModel(
        id=model_id(pair.cable, pair.surface, when),
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
