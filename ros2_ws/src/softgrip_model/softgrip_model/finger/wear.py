# SPDX-License-Identifier: Apache-2.0
"""Has the friction or the stiffness of a finger moved? Decided on empty closings, from tension and tip together.

Each closing gives one least-squares estimate of two shifts: a factor on ln Rf and a factor on the moduli. Tip or angles
alone cannot see the stiffness, and tension alone hardly separates the two (docs/finger.md), so both are used. The model
is solved anew at the shifts found (Gauss-Newton): to first order alone, twice the friction looks like stiffer strips.

The first closings set the baseline; after it a two-sided CUSUM per shift decides. A baseline of few closings is itself
uncertain, which a plain CUSUM takes for a shift sooner or later; so it is self-starting (Hawkins, Journal of Quality
Technology 19, 1987): each closing is judged against all calm ones before it, by the deviation of that comparison.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.closing_samples import ClosingCollector, ClosingInstant, SamplingRule
from softgrip_model.finger.design import Finger
from softgrip_model.finger.kernel import Kernel
from softgrip_model.finger.uncertainty import SCALED_COEFFICIENTS
from softgrip_model.friction.laws import FrictionLaw

Array = NDArray[np.float64]

#: Gauss-Newton ends after so many steps, or when none of the shifts changes by more than this.
_MAX_STEPS, _SETTLED_SHIFT = 6, 1e-4
#: Shifts are looked for between these: no model reaches further.
_MIN_SHIFT, _LARGEST_SHIFT = -0.9, 4.0

#: Beside a shift of the friction, one of the stiffness with a smaller share of its deviations is what the model lacks.
_MIN_BESIDE = 0.25

#: So a reason begins before there is a verdict.
LEARNING = "learning the baseline"


class WearVerdict(IntEnum):
    """What to do about a finger."""

    OK = 1
    WATCH = 2
    RECALIBRATE = 3
    WORN = 4


@dataclass(frozen=True)
class WearSettings:
    """Noise and decision limits.

    Attributes:
        tip_stddev_mm: of the measured tip.
        tension_stddev: of the measured tension, relative.
        tension_floor_n: [N] added to it.
        spacing_mm: pulled length between the samples of a closing.
        min_pulled_mm: shortest pull that is looked at.
        min_samples: of a closing that counts.
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
    min_pulled_mm: float = 1.0
    min_samples: int = 8
    baseline: int = 5
    settled: int = 30
    allowance: float = 0.5
    limit: float = 5.0
    largest_score: float = 4.0
    worn_friction: float = 0.5


@dataclass(frozen=True)
class WearShift:
    """One closing's estimate."""

    friction: float
    stiffness: float
    """relative changes of ln Rf and of the moduli against the prediction"""
    friction_stddev: float
    stiffness_stddev: float


@dataclass
class Cusum:
    """Of one shift, two-sided and self-starting."""

    settings: WearSettings
    values: list[float] = field(default_factory=list)
    """Those that make up the baseline."""
    stddev: float = 0.0
    """Of one closing as its noise has it; the largest so far."""
    up: float = 0.0
    down: float = 0.0
    last: float = 0.0
    """Shift of the latest closing,"""
    score: float = 0.0
    """and how many standard deviations that is."""

    def add(self, value: float, stddev: float) -> None:
        """Take one closing's estimate with its standard deviation; NaN says nothing."""
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
        maximum = self.settings.largest_score
        self.score = self.last / (spread * math.sqrt(1.0 + 1.0 / count))
        score = float(np.clip(self.score, -maximum, maximum))
        self.up = max(0.0, self.up + score - self.settings.allowance)
        self.down = max(0.0, self.down - score - self.settings.allowance)

    @property
    def ready(self) -> bool:
        """Whether the baseline stands."""
        return len(self.values) >= self.settings.baseline

    @property
    def statistic(self) -> float:
        """What is compared with the limit."""
        return max(self.up, self.down)


class WearMonitor:
    """Watches one mounted finger under one friction model; make a new one when either changes."""

    def __init__(self, finger: Finger, law: FrictionLaw, settings: WearSettings) -> None:
        self._finger, self._law, self._settings = finger, law, settings
        self._scaled = np.array(SCALED_COEFFICIENTS[law.law]) * np.array(law.coefficients)
        self._friction = Cusum(settings)
        self._stiffness = Cusum(settings)
        self._collector = ClosingCollector(
            SamplingRule(settings.spacing_mm, settings.min_pulled_mm, settings.min_samples)
        )
        self.closings = 0
        """Closings that counted."""
        self.shift: WearShift | None = None
        """What the last of them said."""

    @property
    def cusum_friction(self) -> float:
        """Decision statistic; alarm above the settings' limit."""
        return self._friction.statistic

    @property
    def cusum_stiffness(self) -> float:
        """Decision statistic; alarm above the settings' limit."""
        return self._stiffness.statistic

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool, temperature_c: float = math.nan) -> None:
        """Take one instant.

        Args:
            sample: pulled length, prediction and measurement.
            pulling: the cable is being pulled.
            free: nothing is held: only then the free model says what to expect.
            temperature_c: not looked at.
        """
        del temperature_c
        closing = self._collector.add(sample, pulling=pulling, free=free)
        if closing:
            self._finish(closing)

    def judge(self) -> tuple[WearVerdict, str]:
        """Return the verdict and what moved, by how much."""
        if not self._stiffness.ready:
            return WearVerdict.OK, f"{LEARNING}: closing {self.closings} of {self._settings.baseline}"
        limit = self._settings.limit
        friction, stiffness = (f"{100 * cusum.last:+.0f} %" for cusum in (self._friction, self._stiffness))
        both = f"friction {friction}, stiffness {stiffness} against the calm ones of {self.closings} closings"
        if self.cusum_stiffness > limit and abs(self._stiffness.score) >= _MIN_BESIDE * abs(self._friction.score):
            return WearVerdict.WORN, f"{both}: the finger's strips have changed; replace it"
        if self.cusum_friction > limit:
            if abs(self._friction.last) > self._settings.worn_friction:
                return WearVerdict.WORN, f"{both}: cable or channel is worn; replace them"
            return WearVerdict.RECALIBRATE, f"{both}: measure the friction anew"
        if self.cusum_stiffness > limit or max(self.cusum_friction, self.cusum_stiffness) > limit / 2:
            return WearVerdict.WATCH, both
        return WearVerdict.OK, ""

    def _finish(self, closing: Sequence[ClosingInstant]) -> None:
        self.shift = shift = self._estimate(closing)
        self.closings += 1
        self._friction.add(shift.friction, shift.friction_stddev)
        self._stiffness.add(shift.stiffness, shift.stiffness_stddev)

    def _estimate(self, closing: Sequence[ClosingInstant]) -> WearShift:
        found = WearShift(math.nan, math.nan, math.nan, math.nan)
        at = np.zeros(2)
        for _ in range(_MAX_STEPS):
            linear = self._linearised(closing, at)
            if linear is None:
                break
            slopes, residual = linear
            free = np.array([bool(slopes[:, 0].any()), True])  # a law without friction has no factor to estimate
            covariance = np.linalg.inv(slopes[:, free].T @ slopes[:, free])
            step = np.zeros(2)
            step[free] = covariance @ (slopes[:, free].T @ residual)
            stddev = np.full(2, math.nan)
            stddev[free] = np.sqrt(np.diag(covariance))
            at = np.clip(at + step, _MIN_SHIFT, _LARGEST_SHIFT)
            found = WearShift(float(at[0]) if free[0] else math.nan, float(at[1]), float(stddev[0]), float(stddev[1]))
            if np.abs(step).max() < _SETTLED_SHIFT:
                break
        return found

    def _linearised(self, closing: Sequence[ClosingInstant], shift: Array) -> tuple[Array, Array] | None:
        """Return slopes (3 K, 2) to both shifts and residuals (3 K,) of the K samples, in standard deviations.

        None where the finger so shifted has no equilibrium at some of them.
        """
        strip = self._finger.strip
        a, b, c = (modulus * (1.0 + shift[1]) for modulus in strip.modulus_mpa)
        finger = dataclasses.replace(self._finger, strip=dataclasses.replace(strip, modulus_mpa=(a, b, c)))
        law = self._law.with_coefficients(np.array(self._law.coefficients) + shift[0] * self._scaled)
        solution = Kernel([finger], law).solve([s.pulled_mm for s in closing], gradient=True, threads=1)
        if solution.failed.any() or solution.gradient is None:
            return None
        n = finger.joints
        seen = slice(n, n + 3)  # tip x, tip y, actuator tension
        slopes = np.stack(
            [
                solution.gradient.friction[0, :, seen] @ self._scaled,
                solution.gradient.stiffness[0, :, seen] / (1.0 + shift[1]),
            ],
            axis=2,
        )
        expected = np.column_stack([solution.tip_mm[0], solution.tension_n[0, :, 0]])
        tip_noise = self._settings.tip_stddev_mm
        noise = np.array([[tip_noise, tip_noise, self._tension_noise(sample)] for sample in closing])
        seen_now = np.array([[*sample.tip_mm, sample.tension_n] for sample in closing])
        residual = (seen_now - expected) / noise
        return (slopes / noise[:, :, None]).reshape(-1, 2), residual.ravel()

    def _tension_noise(self, sample: ClosingInstant) -> float:
        return self._settings.tension_stddev * sample.predicted_n + self._settings.tension_floor_n
