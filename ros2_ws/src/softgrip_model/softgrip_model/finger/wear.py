# SPDX-License-Identifier: Apache-2.0
"""Has the friction or the stiffness of a finger moved? Decided on empty closings, from tension and tip together.

Each closing gives one least-squares estimate of two shifts: a factor on ln Rf and a factor on the moduli. Tip or angles
alone cannot see the stiffness, and tension alone hardly separates the two (docs/finger.md), so both are used. The first
closings set the baseline; after it a two-sided CUSUM per shift decides. A few closings give a baseline that is itself
uncertain, which a plain CUSUM takes for a shift sooner or later; so it is self-starting (Hawkins, Journal of Quality
Technology 19, 1987): each closing is judged against all calm ones before it, by the deviation that this comparison has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.kernel import Solution
from softgrip_model.friction.laws import FrictionLaw, Law

Array = NDArray[np.float64]

#: Pulled lengths that differ by less are the same.
_ROUNDING_MM = 1e-6

_SCALED = {Law.CAPSTAN: (1.0,), Law.HEAP: (1.0, 0.0), Law.MATTE: (1.0, 0.0, 1.0, 1.0)}


class Verdict(IntEnum):
    """What to do about a finger."""

    OK = 0
    WATCH = 1
    RECALIBRATE = 2
    WORN = 3


@dataclass(frozen=True)
class WearSettings:
    """Noise and decision limits.

    Attributes:
        tip_stddev_mm: of the measured tip.
        tension_stddev: of the measured tension, relative.
        tension_floor_n: [N] added to it.
        spacing_mm: pulled length between the samples of a closing.
        least_pull_mm: shortest pull that is looked at.
        least_samples: of a closing that counts.
        baseline: closings that are looked at before the first verdict.
        settled: calm closings after which the baseline stays as it is, so that slow wear is not taken in.
        allowance: CUSUM k [standard deviations].
        limit: CUSUM h [standard deviations].
        largest_score: a closing counts at most this much, so that one odd closing never decides.
        worn_friction: friction shift from which the finger, not the calibration, is at fault.
    """

    tip_stddev_mm: float = 1.0
    tension_stddev: float = 0.05
    tension_floor_n: float = 0.05
    spacing_mm: float = 1.0
    least_pull_mm: float = 1.0
    least_samples: int = 8
    baseline: int = 5
    settled: int = 30
    allowance: float = 0.5
    limit: float = 5.0
    largest_score: float = 4.0
    worn_friction: float = 0.5


@dataclass(frozen=True)
class Shift:
    """One closing's estimate."""

    friction: float
    stiffness: float
    """relative changes of ln Rf and of the moduli against the prediction"""
    friction_stddev: float
    stiffness_stddev: float


@dataclass
class _Cusum:
    """Two-sided and self-starting."""

    settings: WearSettings
    values: list[float] = field(default_factory=list)
    """Those that make up the baseline."""
    stddev: float = 0.0
    """Of one closing as its noise has it; the largest so far."""
    up: float = 0.0
    down: float = 0.0
    last: float = 0.0
    """Shift of the latest closing."""

    def add(self, value: float, stddev: float) -> None:
        if not math.isfinite(value):
            return
        self.stddev = max(self.stddev, stddev)
        if self.ready:
            self._judge(value)
        calm = self.statistic <= self.settings.limit / 2
        if len(self.values) < self.settings.settled and calm:
            self.values.append(value)

    def _judge(self, value: float) -> None:
        count = len(self.values)
        spread = max(self.stddev, float(np.std(self.values, ddof=1)))
        self.last = value - float(np.mean(self.values))
        most = self.settings.largest_score
        score = float(np.clip(self.last / (spread * math.sqrt(1.0 + 1.0 / count)), -most, most))
        self.up = max(0.0, self.up + score - self.settings.allowance)
        self.down = max(0.0, self.down - score - self.settings.allowance)

    @property
    def ready(self) -> bool:
        return len(self.values) >= self.settings.baseline

    @property
    def statistic(self) -> float:
        return max(self.up, self.down)


class WearMonitor:
    """Watches one mounted finger under one friction model; make a new one when either changes."""

    def __init__(self, law: FrictionLaw, settings: WearSettings) -> None:
        self._settings = settings
        self._scaled = np.array(_SCALED[law.law]) * np.array(law.coefficients)
        self._friction = _Cusum(settings)
        self._stiffness = _Cusum(settings)
        self._normal = np.zeros((2, 2))
        self._right = np.zeros(2)
        self._samples = 0
        self._furthest_mm = 0.0
        self.closings = 0
        """Closings that counted."""

    @property
    def cusum_friction(self) -> float:
        """Decision statistic; alarm above the settings' limit."""
        return self._friction.statistic

    @property
    def cusum_stiffness(self) -> float:
        """Decision statistic; alarm above the settings' limit."""
        return self._stiffness.statistic

    def add(self, solution: Solution, tip_mm: Array, tension_n: float, *, pulling: bool, free: bool) -> None:
        """Take one instant.

        Args:
            solution: the prediction with gradients, one finger and one target.
            tip_mm: measured, (2,).
            tension_n: measured at the actuator.
            pulling: the cable is being pulled.
            free: nothing is held: only then the free model says what to expect.
        """
        pulled = float(solution.pulled_mm[0, 0])
        if not free:
            self._forget()
            return
        if not pulling:
            self._finish()
            return
        next_mm = max(self._settings.least_pull_mm, self._furthest_mm + self._settings.spacing_mm)
        usable = pulled >= next_mm - _ROUNDING_MM
        if not usable or solution.gradient is None or not (np.isfinite(tip_mm).all() and math.isfinite(tension_n)):
            return
        rows = solution.gradient.values[0, 0, -5:-2]  # tip x, tip y, actuator tension
        friction = solution.gradient.friction[0, 0, -5:-2] @ self._scaled
        expected = float(solution.tension_n[0, 0, 0])
        noise = np.array(
            [self._settings.tip_stddev_mm] * 2
            + [self._settings.tension_stddev * expected + self._settings.tension_floor_n]
        )
        slopes = np.column_stack([friction, rows[:, -1]]) / noise[:, None]
        residual = np.append(tip_mm - solution.tip_mm[0, 0], tension_n - expected) / noise
        if not np.isfinite(slopes).all():
            return
        self._normal += slopes.T @ slopes
        self._right += slopes.T @ residual
        self._samples += 1
        self._furthest_mm = pulled

    def judge(self) -> tuple[Verdict, str]:
        """Return the verdict and what moved, by how much."""
        if not self._stiffness.ready:
            return Verdict.OK, f"learning the baseline: closing {self.closings} of {self._settings.baseline}"
        limit = self._settings.limit
        friction = f"friction {100 * self._friction.last:+.0f} %"
        stiffness = f"stiffness {100 * self._stiffness.last:+.0f} %"
        since = f"against the calm ones of {self.closings} closings"
        if self.cusum_stiffness > limit and self.cusum_stiffness >= self.cusum_friction:
            return Verdict.WORN, f"{stiffness} {since}: the finger's strips have changed; replace it"
        if self.cusum_friction > limit:
            if abs(self._friction.last) > self._settings.worn_friction:
                return Verdict.WORN, f"{friction} {since}: cable or channel is worn; replace them"
            return Verdict.RECALIBRATE, f"{friction} {since}: measure the friction anew"
        if max(self.cusum_friction, self.cusum_stiffness) > limit / 2:
            return Verdict.WATCH, f"{friction}, {stiffness} {since}"
        return Verdict.OK, ""

    def _finish(self) -> None:
        if self._samples >= self._settings.least_samples:
            shift = self._estimate()
            self.closings += 1
            self._friction.add(shift.friction, shift.friction_stddev)
            self._stiffness.add(shift.stiffness, shift.stiffness_stddev)
        self._forget()

    def _estimate(self) -> Shift:
        if self._normal[0, 0] < 1e-12:  # a law without friction has no factor to estimate
            stiffness = self._right[1] / self._normal[1, 1]
            return Shift(math.nan, float(stiffness), math.nan, float(1.0 / math.sqrt(self._normal[1, 1])))
        covariance = np.linalg.inv(self._normal)
        estimate = covariance @ self._right
        stddev = np.sqrt(np.diag(covariance))
        return Shift(float(estimate[0]), float(estimate[1]), float(stddev[0]), float(stddev[1]))

    def _forget(self) -> None:
        self._normal[:] = 0.0
        self._right[:] = 0.0
        self._samples = 0
        self._furthest_mm = 0.0
