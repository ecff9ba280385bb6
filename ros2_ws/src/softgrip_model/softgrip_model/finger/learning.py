# SPDX-License-Identifier: Apache-2.0
"""How far to trust a finger's prediction, and what its empty closings teach about it (docs/finger.md).

A Kalman filter over the deviations of `Causes`, from a prior of one standard deviation each. Each empty closing is one
measurement of all of them, linearised where the finger stands (iterated: Bell and Cathey, IEEE Trans. Automatic Control
38, 1993). Between closings what was learnt fades towards the prior, so neither mean nor covariance can run away.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.digest import text_digest
from softgrip_model.finger.closing_samples import ClosingCollector, ClosingInstant, SamplingRule
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.kernel import Kernel
from softgrip_model.finger.matching import SPAN_NS
from softgrip_model.finger.uncertainty import MODEL_KNOTS_MM, Causes
from softgrip_model.friction.errors import FrictionError

Array = NDArray[np.float64]

#: [mm] pulled by less a finger is between straight and this; its zero is as uncertain there.
_MIN_PULL_MM = 0.1
#: Gauss-Newton steps of one measurement, and the change [standard deviations] at which it has settled.
_MAX_STEPS, _SETTLED = 4, 1e-3
#: As closings are sampled.
SAMPLING = SamplingRule()
#: Share of the newest closing in the running misfit.
_MISFIT_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A quantity at K pulled lengths: its value, and its slopes to N deviations and to the pulled length [mm]."""

    value: Array
    """(K, ...)"""
    slope: Array
    """(K, ..., N), per standard deviation"""
    rate: Array
    """(K, ...), per mm pulled"""

    def variance(self, covariance: Array, scatter_mm: float) -> Array:
        """Return the variance, shaped as the value, by deviations of a covariance (N, N) and by the pull's scatter."""
        spread = ((self.slope @ covariance) * self.slope).sum(axis=-1)
        return np.asarray(np.maximum(spread, 0.0) + (scatter_mm * self.rate) ** 2)


class ChangedFinger:
    """The finger with deviations z, ready to be solved."""

    def __init__(self, causes: Causes, z: Array) -> None:
        """Prepare it.

        Raises:
            FingerError, FrictionError: no finger or friction has these deviations.
        """
        self._causes, self._z = causes, z
        self._kernel = Kernel([causes.changed_finger(z)], causes.changed_law(z))
        self._law_slopes = causes.law_slopes(z)

    def at(self, pulled_mm: Array) -> tuple[Linearisation, Linearisation, Linearisation] | None:
        """Return joint angles [rad], tip [mm] and actuator tension [N] at pulled lengths (K,); None: no equilibrium."""
        causes, z, n = self._causes, self._z, self._causes.finger.joints
        pulled = causes.changed_pull_mm(z, pulled_mm)
        share = np.clip(pulled / _MIN_PULL_MM, 0.0, 1.0)[:, None]
        solution = self._kernel.solve(np.maximum(pulled, _MIN_PULL_MM), march=False, gradient=True, threads=1)
        if solution.failed.any() or solution.gradient is None:
            return None
        rows = [*range(n), n, n + 1, n + 2]
        slope, rate = self._slopes(solution.gradient.values[0][:, rows], pulled_mm)
        # a stretch takes its pulled length from all that the finger does, whatever it gives already
        slope[..., causes.stretch] = -causes.prior.stretch_mm_per_n * rate * solution.tension_n[0, :, :1]
        weights = causes.model_weights(pulled_mm)
        model = causes.room + 1
        knots = len(MODEL_KNOTS_MM)
        for axis in (0, 1):
            slope[:, n + axis, model + axis * knots : model + (axis + 1) * knots] = weights
        straight = np.array([causes.finger.length_from_joint_mm, 0.0])
        tip = straight + share * (solution.tip_mm[0] - straight)
        tip += np.stack([weights @ z[model : model + knots], weights @ z[model + knots : model + 2 * knots]], axis=1)
        values = (share * solution.angle_rad[0, :, :n], tip, share * solution.tension_n[0, :, :1])
        ends = (slice(0, n), slice(n, n + 2), slice(n + 2, n + 3))
        angle, tip_, tension = (
            Linearisation(value, slope[:, end], rate[:, end]) for value, end in zip(values, ends, strict=True)
        )
        return angle, tip_, tension

    def _slopes(self, gradient: Array, pulled_mm: Array) -> tuple[Array, Array]:
        """Return slopes (K, rows, N) and rates (K, rows) from the kernel's gradient (K, rows, columns)."""
        causes, prior, n = self._causes, self._causes.prior, self._causes.finger.joints
        target, thickness = gradient[..., 0], gradient[..., 1 : 1 + n]
        routing, friction, stiffness = (
            gradient[..., 1 + n : 1 + 3 * n],
            gradient[..., 1 + 3 * n : -1],
            gradient[..., -1],
        )
        count = friction.shape[-1]
        slope = np.zeros((*gradient.shape[:2], len(causes.names)))
        slope[..., : count + 1] = friction @ self._law_slopes
        factor = 1.0 + prior.stiffness * self._z[count + 1]
        slope[..., count + 1] = prior.stiffness / factor * stiffness
        slope[..., count + 2 : count + 2 + n] = prior.thickness_mm * thickness
        slope[..., count + 2 + n : count + 2 + 3 * n] = prior.routing_mm * routing
        slope[..., causes.room] = prior.room_mm * routing.sum(axis=-1)
        slope[..., causes.zero] = prior.zero_mm * target
        slope[..., causes.zero + 1] = prior.spool * pulled_mm[:, None] * target
        return slope, target


@dataclass(frozen=True, eq=False)
class Believed:
    """Joint angles (K, n) [rad] and tips (K, 2) [mm] with their standard deviations."""

    angle_rad: Array
    angle_stddev_rad: Array
    tip_mm: Array
    tip_stddev_mm: Array


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of a finger: deviations' mean (N,) and covariance (N, N), in standard deviations of the prior.

    Attributes:
        closings: that were learnt from.
        misfit: running mean of squared residuals over what was expected of them, 1 or more; covers what no cause does.
    """

    causes: Causes
    mean: Array
    covariance: Array
    closings: int = 0
    misfit: float = 1.0

    @classmethod
    def prior(cls, causes: Causes) -> Knowledge:
        """Return what is known before anything was seen."""
        return cls(causes, *causes.expected)

    @functools.cached_property
    def finger(self) -> ChangedFinger:
        """The finger as it is known."""
        return ChangedFinger(self.causes, self.mean)

    @functools.cached_property
    def digest(self) -> str:
        """Changes when any number of it does."""
        return text_digest(f"{self.mean.tobytes().hex()};{self.covariance.tobytes().hex()};{self.misfit!r}")

    @functools.cached_property
    def name(self) -> str:
        """Of its prior and all its numbers."""
        return f"{self.causes.prior}:{self.digest}"

    def predict(self, pulled_mm: Array) -> Believed | None:
        """Return joint angles and tip at pulled lengths (K,); None where the finger has no equilibrium."""
        found = self.finger.at(pulled_mm)
        if found is None:
            return None
        angle, tip, _ = found
        scatter = self.causes.prior.scatter_mm
        deviations = [np.sqrt(self.misfit * one.variance(self.covariance, scatter)) for one in (angle, tip)]
        # what moves the tip beside its kernel turns joints, too: about the middle of the finger
        lever_mm = 0.5 * self.causes.finger.length_from_joint_mm
        weights = self.causes.model_weights(pulled_mm)
        model = np.sqrt((weights**2).sum(axis=1)) / lever_mm
        return Believed(angle.value, np.hypot(deviations[0], model[:, None]), tip.value, deviations[1])

    def faded(self) -> Knowledge:
        """Return what of it the next closing still believes."""
        memory, (mean, covariance) = self.causes.prior.memory, self.causes.expected
        return Knowledge(
            self.causes,
            memory * self.mean + (1.0 - memory) * mean,
            memory**2 * self.covariance + (1.0 - memory**2) * covariance,
            self.closings,
            self.misfit,
        )

    def learnt(self, closing: Sequence[ClosingInstant]) -> Knowledge:
        """Return what is known after one more closing."""
        before = self.faded()
        update = Update.of(self.causes, before.mean, before.covariance, closing)
        if update is None:
            return before
        misfit = max(1.0, (1.0 - _MISFIT_SHARE) * self.misfit + _MISFIT_SHARE * update.misfit)
        return Knowledge(self.causes, update.mean, update.covariance, self.closings + 1, misfit)

    def summary(self) -> str:
        """Return what was learnt, the best known first, in words."""
        deviations = np.sqrt(np.diag(self.covariance))
        order = np.argsort(deviations, kind="stable")[:4]
        known = ", ".join(
            f"{self.causes.names[i]} {self.mean[i]:+.1f} sd (known to {deviations[i]:.2f})" for i in order
        )
        return f"closing {self.closings}: {known}; misfit {self.misfit:.1f}"


@dataclass(frozen=True, eq=False)
class Expectation:
    """A closing of K samples as it is expected: 3 K numbers, tips x and y one after the other, then tensions."""

    value: Array
    """(3 K,) [mm], [N]"""
    slope: Array
    """(3 K, N)"""
    noise: Array
    """(3 K, 3 K) covariance of what no deviation explains"""

    @classmethod
    def of(cls, causes: Causes, z: Array, closing: Sequence[ClosingInstant]) -> Expectation | None:
        """Return it at deviations z; None where the finger so changed has no equilibrium."""
        pulled = np.array([sample.pulled_mm for sample in closing])
        try:
            found = ChangedFinger(causes, z).at(pulled)
        except (FingerError, FrictionError):
            return None
        if found is None:
            return None
        _, tip, tension = found
        prior, gain, camera = causes.prior, causes.zero + 2, causes.zero + 3
        scale, turn = prior.camera_scale * z[camera + 2], prior.camera_turn_rad * z[camera + 3]
        image = np.array([[1.0 + scale, -turn], [turn, 1.0 + scale]])
        seen = tip.value @ image.T + prior.camera_mm * z[camera : camera + 2]
        slope = np.einsum("ab,kbn->kan", image, tip.slope)
        for axis in (0, 1):
            slope[:, axis, camera + axis] = prior.camera_mm
        slope[..., camera + 2] = prior.camera_scale * tip.value
        slope[..., camera + 3] = prior.camera_turn_rad * np.stack([-tip.value[:, 1], tip.value[:, 0]], axis=1)
        factor = 1.0 + prior.tension_gain * z[gain]
        tension_read, tension_slope = factor * tension.value, factor * tension.slope
        tension_slope[..., gain] = prior.tension_gain * tension.value
        errors = causes.tension_weights(pulled)
        tension_read = tension_read + (errors @ z[causes.tension])[:, None]
        tension_slope[..., causes.tension] = errors[:, None, :]
        rate = np.concatenate([tip.rate.ravel(), factor * tension.rate.ravel()])
        expected_n = np.array([sample.predicted_n for sample in closing])
        white = np.concatenate(
            [
                np.full(2 * len(closing), prior.tip_noise_mm),
                prior.tension_noise * expected_n + prior.tension_floor_n,
            ]
        )
        noise = np.diag(white**2) + prior.scatter_mm**2 * np.outer(rate, rate)
        count = len(z)
        return cls(
            np.concatenate([seen.ravel(), tension_read.ravel()]),
            np.concatenate([slope.reshape(-1, count), tension_slope.reshape(-1, count)]),
            noise,
        )


def measured(closing: Sequence[ClosingInstant]) -> Array:
    """Return the numbers of a closing in the order of `Expectation`, (3 K,)."""
    return np.concatenate(
        [np.array([sample.tip_mm for sample in closing]).ravel(), [sample.tension_n for sample in closing]]
    )


@dataclass(frozen=True, eq=False)
class Update:
    """Mean and covariance after one closing, and its misfit: squared residuals over what was expected of them."""

    mean: Array
    covariance: Array
    misfit: float

    @classmethod
    def of(cls, causes: Causes, mean: Array, covariance: Array, closing: Sequence[ClosingInstant]) -> Update | None:
        """Return it from mean and covariance before the closing; None where no such finger closes like that."""
        seen, z, misfit = measured(closing), mean, 1.0
        gain = expected = None
        for step in range(_MAX_STEPS):
            expected = Expectation.of(causes, z, closing)
            if expected is None:
                return None
            slope = expected.slope
            innovation = seen - expected.value - slope @ (mean - z)
            total = slope @ covariance @ slope.T + expected.noise
            if step == 0:
                misfit = float(innovation @ np.linalg.solve(total, innovation)) / len(seen)
            gain = np.linalg.solve(total, slope @ covariance).T
            moved = causes.bounded(mean + gain @ innovation, covariance - gain @ slope @ covariance)
            change = float(np.abs(moved - z).max())
            z = moved
            if change < _SETTLED:
                break
        if gain is None or expected is None or not (np.isfinite(z).all() and math.isfinite(misfit)):
            return None
        # Joseph's form: symmetric and positive whatever is rounded
        kept = np.eye(len(z)) - gain @ expected.slope
        return cls(z, kept @ covariance @ kept.T + gain @ expected.noise @ gain.T, misfit)


class FingerLearner:
    """Learns one mounted finger under one friction model; make a new one when either changes.

    A closing counts from the first time on that the finger is open SPAN_NS after its end: by then every measurement of
    it has come, in whatever order the topics arrived, and no closing is predicted with two states of knowledge.
    """

    def __init__(self, causes: Causes, rule: SamplingRule = SAMPLING) -> None:
        self._collector = ClosingCollector(rule)
        self._learnt: list[tuple[int, Knowledge]] = []  # may be used from a stamp on
        self._used = [(0, Knowledge.prior(causes))]  # from a stamp on

    @property
    def newest(self) -> Knowledge:
        """What all closings that have ended say."""
        return self._learnt[-1][1] if self._learnt else self._used[-1][1]

    def at(self, stamp: int) -> Knowledge:
        """Return what a prediction at a stamp [ns] goes by."""
        return next((known for since, known in reversed(self._used) if since <= stamp), self._used[0][1])

    def note_open(self, stamp: int) -> None:
        """Record that the finger is open at a stamp [ns]: what may be used by then is, after it."""
        known = next((known for since, known in reversed(self._learnt) if since <= stamp), None)
        if known is None or known is self.at(stamp + 1):
            return
        self._used.append((stamp + 1, known))
        while len(self._used) > 1 and self._used[1][0] < stamp - 2 * SPAN_NS:
            self._used.pop(0)

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool) -> Knowledge | None:
        """Take one instant; return what is known after the closing that it ends."""
        closing = self._collector.add(sample, pulling=pulling, free=free)
        if not closing:
            return None
        known = self.newest.learnt(closing)
        self._learnt.append((sample.stamp + SPAN_NS, known))
        while len(self._learnt) > 1 and self._learnt[1][0] < sample.stamp - 2 * SPAN_NS:
            self._learnt.pop(0)
        return known
