# SPDX-License-Identifier: Apache-2.0
"""The guided friction measurement as pages show it, and the list of models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

#: So many points are kept; a full plan has 45.
MAX_POINTS: Final = 200


@dataclass(frozen=True)
class RigPoint:
    """One measured point (rig/sample)."""

    index: int
    angle_rad: float
    load_kg: float
    tension_low_n: float
    tension_high_n: float
    stddev_n: float
    verdict: str
    reason: str

    @property
    def ratio(self) -> float:
        """T1 / T2."""
        return self.tension_high_n / self.tension_low_n if self.tension_low_n > 0.0 else math.nan


@dataclass(frozen=True)
class FrictionModelView:
    """One model of the list; an interval of 95 % for each coefficient, NaN where the fit gave none."""

    id: str
    law: str
    coefficients: tuple[tuple[str, float, float], ...]
    average_error: float
    maximum_error: float
    points: int
    age_s: float
    verdict: str
    reason: str
    is_active: bool
    cable: str = ""
    surface: str = ""


@dataclass(frozen=True)
class RigProgress:
    """Where a measurement is; `phase` as CalibrateFriction's feedback names it, "" = none goes on."""

    phase: str = ""
    index: int = 0
    total: int = 0
    angle_rad: float = 0.0
    load_kg: float = 0.0
    instruction: str = ""
    points: tuple[RigPoint, ...] = ()
    is_running: bool = False
    message: str = ""
    fitted: str = ""

    @property
    def needs_confirmation(self) -> bool:
        """Whether a person has to set angle and weight, and say so."""
        return self.is_running and self.phase == "SET_UP"

    def begun(self) -> RigProgress:
        """Return a new measurement."""
        return RigProgress(is_running=True)

    def with_point(self, point: RigPoint) -> RigProgress:
        """Return it with one more point."""
        return replace(self, points=(*self.points, point)[-MAX_POINTS:])

    def ended(self, message: str, fitted: str) -> RigProgress:
        """Return it with its end; `fitted` is the id of the model, "" = none."""
        return replace(self, is_running=False, phase="", message=message, fitted=fitted)


def intervals(
    names: Sequence[str], values: Sequence[float], covariance: Sequence[float]
) -> tuple[tuple[str, float, float], ...]:
    """Return (name, value, half width of 95 %) of coefficients; row-major covariance, NaN where there is none."""
    count = len(names)
    known = len(covariance) == count * count
    return tuple(
        (name, value, 1.96 * math.sqrt(max(0.0, covariance[k * count + k])) if known else math.nan)
        for k, (name, value) in enumerate(zip(names, values, strict=False))
    )
