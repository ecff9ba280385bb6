# SPDX-License-Identifier: Apache-2.0
"""The guided friction measurement as pages show it, and the list of models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
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
    """Where a measurement is (rig/progress), or how the last one ended; `fitted` is the id of its model, "" = none.

    Attributes:
        needs_confirmation: a person has to set angle and weight, and say so.
    """

    is_running: bool = False
    needs_confirmation: bool = False
    index: int = 0
    total: int = 0
    angle_rad: float = 0.0
    load_kg: float = 0.0
    instruction: str = ""
    points: tuple[RigPoint, ...] = ()
    message: str = ""
    fitted: str = ""


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
