# SPDX-License-Identifier: Apache-2.0
"""The guided friction measurement as pages show it, the list of models, a model's curve, and what was refused."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from softgrip_model.durable import write_durably
from softgrip_model.friction.laws import GRAVITY, FrictionLaw
from softgrip_model.friction.student import t_quantile

#: So many points are kept; a full plan has 45.
MAX_POINTS: Final = 200
#: So many loads have a curve of their own.
MAX_CURVES: Final = 4
#: Points of a curve.
_STEPS: Final = 41
#: So many refusals are kept.
MAX_REFUSALS: Final = 500
#: Of every interval that is shown.
_LEVEL: Final = 0.95


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
    """One model of the list; an interval of 95 % for each coefficient, NaN where the fit gave none.

    Attributes:
        law_found: the law with its numbers; None where they are no law's.
        covariance: of its coefficients, row by row; empty = unknown.
        degrees_of_freedom: of the fit; 0 = unknown.
    """

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
    law_found: FrictionLaw | None = None
    covariance: tuple[float, ...] = ()
    degrees_of_freedom: int = 0


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
    names: Sequence[str], values: Sequence[float], covariance: Sequence[float], degrees_of_freedom: int
) -> tuple[tuple[str, float, float], ...]:
    """Return (name, value, half width of 95 %) of coefficients.

    Args:
        names: of the coefficients.
        values: of them.
        covariance: row by row; of another size = unknown, and the half widths are NaN.
        degrees_of_freedom: of the fit; 0 = unknown, and the interval is the normal distribution's.
    """
    count = len(names)
    known = len(covariance) == count * count
    quantile = _quantile(degrees_of_freedom)
    return tuple(
        (name, value, quantile * math.sqrt(max(0.0, covariance[k * count + k])) if known else math.nan)
        for k, (name, value) in enumerate(zip(names, values, strict=False))
    )


def _quantile(degrees_of_freedom: int) -> float:
    return t_quantile(0.5 + _LEVEL / 2.0, degrees_of_freedom if degrees_of_freedom > 0 else math.inf)


@dataclass(frozen=True)
class LoadCurve:
    """T1/T2 over the wrap angle at one T2: points of (angle [rad], ratio, lowest, highest of the 95 % interval).

    Where the model states no interval, lowest and highest are NaN.
    """

    tension_low_n: float
    points: tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True)
class FitPicture:
    """A model's curves, and the measured points: each with the number of the curve whose T2 is nearest, -1 = none."""

    curves: tuple[LoadCurve, ...]
    points: tuple[tuple[RigPoint, int], ...]


def fit_picture(model: FrictionModelView | None, points: Sequence[RigPoint]) -> FitPicture:
    """Return what is drawn of a model beside measured points.

    Args:
        model: None = the points alone.
        points: measured; without any, the curves are those of the lowest, the middle and the highest calibrated T2.
    """
    law = model.law_found if model else None
    if law is None or model is None:
        return FitPicture((), tuple((one, -1) for one in points))
    loads = sorted({round(one.load_kg, 3) for one in points})
    if len(loads) > MAX_CURVES:
        loads = [loads[round(k * (len(loads) - 1) / (MAX_CURVES - 1))] for k in range(MAX_CURVES)]
    tensions = [GRAVITY * load for load in loads] or list(np.linspace(*law.tension_range, 3))
    ends = [math.degrees(one.angle_rad) for one in points] + [math.degrees(law.angle_range[1])]
    angles = np.linspace(0.0, math.radians(max(ends)), _STEPS)
    curves = tuple(_curve(law, model, angles, float(tension)) for tension in tensions)
    return FitPicture(
        curves,
        tuple(
            (one, min(range(len(curves)), key=lambda k: abs(curves[k].tension_low_n - one.tension_low_n)))
            for one in points
        ),
    )


def _curve(law: FrictionLaw, model: FrictionModelView, angles: np.ndarray, tension_n: float) -> LoadCurve:
    found = law.evaluate(angles, tension_n)
    slopes, count = found.d_coefficients, len(law.names)
    half = np.full(len(angles), math.nan)
    if len(model.covariance) == count * count:
        covariance = np.reshape(model.covariance, (count, count))
        variance = np.maximum(np.einsum("ni,ij,nj->n", slopes, covariance, slopes), 0.0)
        half = np.sqrt(variance) * _quantile(model.degrees_of_freedom)
    low, high = (np.exp(found.log_ratio + sign * half) for sign in (-1.0, 1.0))
    return LoadCurve(
        tension_n,
        tuple(
            (float(angle), float(ratio), float(ratio_min), float(ratio_max))
            for angle, ratio, ratio_min, ratio_max in zip(angles, found.ratio, low, high, strict=True)
            if math.isfinite(ratio)
        ),
    )


@dataclass(frozen=True)
class Refusal:
    """Who refused a model, why, and when, in seconds since the Unix epoch."""

    who: str
    reason: str
    at_s: float


class FrictionRefusals:
    """Models that somebody refused: shown beside them, wherever the list is; none of them is gone.

    Kept in a file of this user alone, so that a restarted panel knows them, too. The cell's audit table has them in any
    case.
    """

    def __init__(self) -> None:
        self._refused: dict[str, Refusal] = {}
        self._file: Path | None = None

    def keep_in(self, file: Path) -> None:
        """Keep refusals in a file, and take up what stands there; a spoiled file has none."""
        self._file = file
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
            found = {str(model): Refusal(str(one["who"]), str(one["reason"]), float(one["at_s"]))
                     for model, one in document.items()}  # fmt: skip
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return
        self._refused = found

    def find(self, model: str) -> Refusal | None:
        """Return the refusal of a model; None where nobody refused it."""
        return self._refused.get(model)

    def add(self, model: str, refusal: Refusal) -> None:
        """Take a refusal; a later one of the same model takes its place."""
        self._refused.pop(model, None)
        self._refused[model] = refusal
        while len(self._refused) > MAX_REFUSALS:
            del self._refused[next(iter(self._refused))]
        self._write()

    def lift(self, model: str) -> None:
        """A refused model was activated all the same: it is refused no more."""
        if self._refused.pop(model, None) is not None:
            self._write()

    def _write(self) -> None:
        if self._file is None:
            return
        document = {model: asdict(one) for model, one in self._refused.items()}
        # a full disk takes nothing but what a restarted panel shows: the audit table has it
        with contextlib.suppress(OSError):
            write_durably(self._file, json.dumps(document).encode(), 0o600)
