# SPDX-License-Identifier: Apache-2.0
"""What has changed about a finger? Likelihood ratios of causes over its empty closings (docs/finger.md).

The first closings of a finger set what is known of it (`Knowledge`), how closings go and how they scatter. Later ones
are compared with the calm ones before: their mean difference is explained by each cause in turn, by the slopes of the
filter's linearisation, its amount being unknown with a prior deviation of its own. Before any cause is named, the
difference has to be too large to be chance, and what the cause leaves of it small enough to be chance; otherwise it is
"none of these". The ratio of one cause to the next has to be large, or both are named. Only a cause that is wear calls
a finger worn.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.closing_samples import ClosingCollector, ClosingInstant
from softgrip_model.finger.learning import SAMPLING, Expectation, Knowledge, measured
from softgrip_model.finger.uncertainty import Causes
from softgrip_model.finger.wear import WearVerdict
from softgrip_time.units import to_s

Array = NDArray[np.float64]


class Cause(StrEnum):
    """What may have changed."""

    FRICTION = "friction"
    STIFFNESS = "stiffness"
    TEMPERATURE = "temperature"
    CONDITIONS = "speed or rest"
    RUNNING_IN = "running-in"
    STRIP = "one strip"
    ZERO = "zero"
    CABLE = "cable's stretch"
    TENSION_GAIN = "tension gain"
    CAMERA = "camera"
    OUT_OF_PLANE = "out of plane"
    NONE_OF_THESE = "none of these"


#: What to do about each.
REMEDIES = {
    Cause.FRICTION: "measure the friction again",
    Cause.STIFFNESS: "strips are softer or stiffer as one: wait for the usual temperature, then close again",
    Cause.TEMPERATURE: "the room is warmer or colder; nothing is broken",
    Cause.CONDITIONS: "close at the usual speed after the usual rest",
    Cause.RUNNING_IN: "the finger was closed further than before and is softer since; let it learn a new baseline",
    Cause.STRIP: "look for a crack in that strip; replace the finger",
    Cause.ZERO: "home the tendon again",
    Cause.CABLE: "the cable gives more: replace it",
    Cause.TENSION_GAIN: "run calibrate_tension",
    Cause.CAMERA: "calibrate the camera's plane again",
    Cause.OUT_OF_PLANE: "mount the finger in its plane again",
    Cause.NONE_OF_THESE: "look at the finger: its closings fit no known cause",
}

#: Those that a calibration sets right.
TO_CALIBRATE = {Cause.FRICTION, Cause.ZERO, Cause.TENSION_GAIN, Cause.CAMERA, Cause.OUT_OF_PLANE}

#: Gauss-Newton steps for a cause's amount, and the change [prior deviations] at which it has settled.
_MAX_STEPS, _SETTLED = 4, 0.02

#: Calm closings that scatter can be estimated from.
_MIN_CALM = 4

#: Prior deviation of each amount, in deviations of `Uncertainty` where it is one of `Causes`, else in its own unit.
_STRIP_SD = 1.5  # 0.15 mm: three tenths of a strip's stiffness
_STIFFNESS_SD = 1.0
_FRICTION_SD = 2.5
_ZERO_SD = 3.0
_GAIN_SD = 1.0
_CAMERA_SD = (5.0, 5.0, 5.0, 5.0)
_CABLE_SD = 0.10  # mm per N
_PLANE_SD = 0.03  # share that y is foreshortened by: 14 degrees


@dataclass(frozen=True)
class WatchSettings:
    """When a change is called one.

    Attributes:
        baseline: closings that set what is known before the first verdict.
        settled: calm closings after which the baseline stays as it is, so that slow changes are not taken in.
        window: latest closings whose residuals are averaged.
        limit: log-likelihood ratio of a cause to no change from which there is one.
        worn_limit: the same for calling a finger worn.
        margin: of a cause to the next from which it alone is named.
        misfit_limit: standard deviations that what a cause leaves may exceed its expectation by.
        slope_error: how far the kernel's answer to a cause is believed, relative.
        worn_friction: friction shift from which cable or channel are worn.
        conditions_factor: speeds and rests beyond the baseline's range by this factor are unusual.
        temperature_k: change from which the temperature is one.
    """

    baseline: int = 5
    settled: int = 12
    window: int = 5
    limit: float = 6.0
    worn_limit: float = 15.0
    margin: float = 3.0
    misfit_limit: float = 6.0
    slope_error: float = 0.20
    worn_friction: float = 0.5
    conditions_factor: float = 1.5
    temperature_k: float = 3.0


#: As shipped.
WATCH = WatchSettings()


@dataclass(frozen=True)
class ClosingConditions:
    """How a closing was made.

    Attributes:
        speed_mm_per_s: mean; rest_s: since the one before ended, NaN for the first; temperature_c: NaN unknown.
        further_mm: by how much the closing before this one went beyond all earlier ones.
    """

    speed_mm_per_s: float
    rest_s: float = math.nan
    temperature_c: float = math.nan
    further_mm: float = 0.0


@dataclass(frozen=True)
class Explanation:
    """A cause that explains the latest closings.

    Attributes:
        log_ratio: of its likelihood to that of no change.
        amount: in words.
        shift: relative or in the cause's unit; for strips the joint stands in `amount`.
    """

    cause: Cause
    log_ratio: float
    amount: str
    shift: float


@dataclass(frozen=True)
class Diagnosis:
    """What a watch says after a closing: the likeliest causes, best first; empty: no change."""

    explanations: tuple[Explanation, ...] = ()
    misfit: float = 0.0
    """Standard deviations by which what the best cause leaves exceeds its expectation."""

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Those that cannot be told apart."""
        return tuple(explanation.cause for explanation in self.explanations)


@dataclass(frozen=True, eq=False)
class _Signature:
    """What a cause of unknown amounts does to a closing.

    Attributes:
        slope: (3 K, a) of what is expected; stddev: (a,) of the amounts before anything was seen.
        place: of the amount among `Causes`; None: not one of them.
        exact: what it does follows from geometry alone.
        shortens: the amount is pull that is lost per tension [mm/N].
        unit, words: of the first amount, for people.
        sign: +1 or -1: only amounts of that sign are this cause.
    """

    cause: Cause
    slope: Array
    stddev: Array
    place: int | None = None
    shortens: bool = False
    exact: bool = False
    unit: float = 1.0
    words: str = "{:+.0%}"
    sign: int = 0


#: Smallest scatter of closings that is believed: tips [mm], tensions [1], pull [mm], stiffness, friction [1].
_MIN_TIP_MM, _MIN_TENSION, _MIN_PULL_MM, _MIN_STIFFNESS, _MIN_FRICTION = 0.1, 0.01, 0.02, 0.01, 0.02


@dataclass(frozen=True, eq=False)
class _Residual:
    """Measured less expected of a closing with K samples, and what may change it.

    Attributes:
        closing: as it was measured.
        expected: (3 K,), tips x and y one after the other, then tensions.
        value: (3 K,) beside them.
        wandering: (3 K, 3) slopes to the pull [mm], the stiffness and the friction [1]: these differ a little from
            closing to closing.
        tension_n: (K,) expected.
        signatures: of the causes.
    """

    closing: tuple[ClosingInstant, ...]
    expected: Array
    value: Array
    wandering: Array
    tension_n: Array
    signatures: tuple[_Signature, ...]

    @property
    def samples(self) -> int:
        """K."""
        return len(self.tension_n)

    def shortened(self, samples: int) -> _Residual:
        """Return that of the first so many samples."""
        rows = [*range(2 * samples), *range(2 * self.samples, 2 * self.samples + samples)]
        signatures = tuple(dataclasses.replace(one, slope=one.slope[rows]) for one in self.signatures)
        return _Residual(
            self.closing[:samples],
            self.expected[rows],
            self.value[rows],
            self.wandering[rows],
            self.tension_n[:samples],
            signatures,
        )


@dataclass(frozen=True, eq=False)
class _Scatter:
    """Mean of calm closings' residuals, and the covariance of one more closing about it."""

    mean: Array
    covariance: Array

    @classmethod
    def of(cls, calm: Sequence[_Residual]) -> _Scatter:
        """Estimate it: each closing's wandering by least squares, what is left as noise of tips and of tensions."""
        count, newest = len(calm), calm[-1]
        values = np.array([one.value for one in calm])
        mean = values.mean(axis=0)
        tips = 2 * newest.samples
        weight = np.concatenate([np.full(tips, 1.0), 1.0 / (0.05 * newest.tension_n + 0.05)])
        slope = newest.wandering * weight[:, None]
        shifts = np.linalg.lstsq(slope, ((values - mean) * weight).T, rcond=None)[0].T
        left = values - mean - shifts @ newest.wandering.T
        # the fewer closings, the further the next may lie (the factor of a predictive t distribution)
        widen = (count + 1.0) / (count - 2.0)
        smallest = np.array([_MIN_PULL_MM, _MIN_STIFFNESS, _MIN_FRICTION])
        wander = widen * shifts.T @ shifts / count + np.diag(smallest**2)
        tip_mm = max(_MIN_TIP_MM, math.sqrt(widen * float((left[:, :tips] ** 2).mean())))
        relative = left[:, tips:] / (newest.tension_n + 0.1)
        tension = max(_MIN_TENSION, math.sqrt(widen * float((relative**2).mean())))
        white = np.concatenate([np.full(tips, tip_mm), tension * (newest.tension_n + 0.1)])
        return cls(mean, np.diag(white**2) + newest.wandering @ wander @ newest.wandering.T)


class CauseWatch:
    """Watches one mounted finger under one friction model; make a new one when either changes."""

    def __init__(self, causes: Causes, settings: WatchSettings) -> None:
        self._causes, self._settings = causes, settings
        self._collector = ClosingCollector(SAMPLING)
        self._reference = Knowledge.prior(causes)
        self._first: list[tuple[ClosingInstant, ...]] = []
        self._calm: list[_Residual] = []
        self._usual: list[ClosingConditions] = []
        self._latest: deque[tuple[_Residual, ClosingConditions]] = deque(maxlen=settings.window)
        self._ended: int | None = None
        self._furthest_mm = self._further_mm = 0.0
        self.closings = 0
        """Closings that counted."""
        self.diagnosis = Diagnosis()
        """After the last of them."""
        self._before: tuple[Cause, ...] = ()

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool, temperature_c: float = math.nan) -> None:
        """Take one instant; `ClosingCollector.add` has the arguments."""
        closing = self._collector.add(sample, pulling=pulling, free=free)
        if closing:
            self.take(closing, self._conditions(closing, temperature_c))
            self._ended = sample.stamp

    def take(self, closing: tuple[ClosingInstant, ...], conditions: ClosingConditions) -> Diagnosis:
        """Take one closing; return what it says with those before."""
        self.closings += 1
        if self.closings <= self._settings.baseline:
            self._first.append(closing)
            self._usual.append(conditions)
            self._reference = self._reference.learnt(closing)
            if self.closings == self._settings.baseline:
                found = [self._residual(one, conditions) for one in self._first]
                self._calm = [one for one in found if one is not None]
            return self.diagnosis
        residual = self._residual(closing, conditions)
        if residual is None or len(self._calm) < _MIN_CALM:
            return self.diagnosis
        self._latest.append((residual, conditions))
        self._before, self.diagnosis = self.diagnosis.causes, self._diagnose()
        if not self.diagnosis.explanations and len(self._calm) < self._settings.settled:
            self._calm.append(residual)
            self._usual.append(conditions)
        return self.diagnosis

    def judge(self) -> tuple[WearVerdict, str]:
        """Return the verdict and what follows from it, in words."""
        if self.closings < self._settings.baseline:
            return WearVerdict.OK, f"learning the baseline: closing {self.closings} of {self._settings.baseline}"
        if not self.diagnosis.explanations:
            return WearVerdict.OK, ""
        found = "; or ".join(f"{one.cause} {one.amount}: {REMEDIES[one.cause]}" for one in self.diagnosis.explanations)
        return self._verdict(self.diagnosis.explanations), found

    @property
    def cusum_friction(self) -> float:
        """Decision statistic of the friction: a log-likelihood ratio."""
        return self.log_ratio(Cause.FRICTION)

    @property
    def cusum_stiffness(self) -> float:
        """Decision statistic of the stiffness: a log-likelihood ratio."""
        return self.log_ratio(Cause.STIFFNESS)

    def log_ratio(self, cause: Cause) -> float:
        """Return a cause's log-likelihood ratio where it is among the likeliest, else 0."""
        return max((one.log_ratio for one in self.diagnosis.explanations if one.cause is cause), default=0.0)

    def _verdict(self, explanations: Sequence[Explanation]) -> WearVerdict:
        """Return what the causes that cannot be told apart agree on: a finger is worn when all of them are wear."""
        verdicts = {self._verdict_of(one) for one in explanations}
        if WearVerdict.WORN in verdicts and len(verdicts) > 1:
            return WearVerdict.RECALIBRATE if WearVerdict.RECALIBRATE in verdicts else WearVerdict.WATCH
        return max(verdicts)

    def _verdict_of(self, explanation: Explanation) -> WearVerdict:
        much = explanation.cause is Cause.FRICTION and abs(explanation.shift) > self._settings.worn_friction
        if explanation.cause in {Cause.STRIP, Cause.CABLE} or much:
            sure = explanation.log_ratio > self._settings.worn_limit and explanation.cause in self._before
            return WearVerdict.WORN if sure else WearVerdict.WATCH
        if explanation.cause is Cause.CONDITIONS and explanation.log_ratio <= self._settings.limit:
            return WearVerdict.OK
        return WearVerdict.RECALIBRATE if explanation.cause in TO_CALIBRATE else WearVerdict.WATCH

    def _conditions(self, closing: Sequence[ClosingInstant], temperature_c: float) -> ClosingConditions:
        first, last = closing[0], closing[-1]
        duration_s = max(to_s(last.stamp - first.stamp), 1e-3)
        rest_s = math.nan if self._ended is None else to_s(first.stamp - self._ended)
        speed = (last.pulled_mm - first.pulled_mm) / duration_s
        made = ClosingConditions(speed, rest_s, temperature_c, self._further_mm)
        self._further_mm = max(0.0, last.pulled_mm - self._furthest_mm) if self._furthest_mm else 0.0
        self._furthest_mm = max(self._furthest_mm, last.pulled_mm)
        return made

    def _residual(self, closing: tuple[ClosingInstant, ...], conditions: ClosingConditions) -> _Residual | None:
        expected = Expectation.of(self._causes, self._reference.mean, closing)
        if expected is None:
            return None
        causes, prior = self._causes, self._causes.prior
        places, units = (
            [causes.zero, causes.factor + 1, causes.factor],
            [prior.zero_mm, prior.stiffness, prior.friction],
        )
        return _Residual(
            closing,
            expected.value,
            measured(closing) - expected.value,
            expected.slope[:, places] / np.array(units),
            np.array([sample.predicted_n for sample in closing]),
            tuple(self._signatures(closing, expected, conditions)),
        )

    def _diagnose(self) -> Diagnosis:
        """Return the strongest of what the last closing, the last two and all of the window say."""
        best = Diagnosis()
        for count in sorted({1, min(2, len(self._latest)), len(self._latest)}):
            found = self._explain([one for one, _ in list(self._latest)[-count:]])
            if found.explanations and (
                not best.explanations or found.explanations[0].log_ratio > best.explanations[0].log_ratio
            ):
                best = found
        conditions = self._latest[-1][1]
        if not best.explanations and self._unusual(conditions):
            return Diagnosis((Explanation(Cause.CONDITIONS, 0.0, self._unusual(conditions), 0.0),))
        return best

    def _explain(self, latest: Sequence[_Residual]) -> Diagnosis:
        settings = self._settings
        samples = min(one.samples for one in (*latest, *self._calm))
        calm, latest = ([one.shortened(samples) for one in each] for each in (self._calm, latest))
        usual = _Scatter.of(calm)
        residual: Array = np.asarray(np.mean([one.value for one in latest], axis=0) - usual.mean)
        covariance: Array = (1.0 / len(latest) + 1.0 / len(calm)) * usual.covariance
        squared, count = float(residual @ np.linalg.solve(covariance, residual)), len(residual)
        newest = latest[-1]
        explained = [self._explained(one, newest, residual, covariance) for one in newest.signatures]
        explanations = sorted((one for one in explained if one is not None), key=lambda one: -one[0].log_ratio)
        chance = (squared - count) / math.sqrt(2.0 * count)
        if not explanations or explanations[0][0].log_ratio < settings.limit:
            if chance <= settings.misfit_limit:
                return Diagnosis()
            return Diagnosis((Explanation(Cause.NONE_OF_THESE, 0.5 * (squared - count), "", chance),), chance)
        best, remaining = explanations[0]
        misfit = (remaining - count) / math.sqrt(2.0 * count)
        if misfit > settings.misfit_limit:
            near = f"(nearest: {best.cause} {best.amount})"
            return Diagnosis((Explanation(Cause.NONE_OF_THESE, best.log_ratio, near, misfit),), misfit)
        near_best = [one for one, _ in explanations if one.log_ratio > best.log_ratio - settings.margin]
        distinct = {one.cause: one for one in reversed(near_best)}
        return Diagnosis(tuple(sorted(distinct.values(), key=lambda one: -one.log_ratio)), misfit)

    def _explained(
        self, signature: _Signature, newest: _Residual, residual: Array, usual: Array
    ) -> tuple[Explanation, float] | None:
        """Return what a cause explains, and the squared residuals that it leaves; None: amounts of the wrong sign.

        Its amounts z (prior N(0, 1) in their deviations) are found by Gauss-Newton; their likelihood is marginalised
        about the best (Laplace), and its effect f is believed as far as the kernel's slopes are (`slope_error`):
        2 ln ratio = r' V^-1 r - l' W^-1 l - z' z - ln det(1 + S' V^-1 S) - ln det(W V^-1), l = r - f,
        W = V + slope_error^2 (f f' of tip x, tip y and tension each for itself).
        """
        inverse = np.linalg.inv(usual)
        slope = signature.slope * signature.stddev
        kept = np.eye(slope.shape[1]) + slope.T @ inverse @ slope
        amounts = np.linalg.solve(kept, slope.T @ inverse @ residual)
        effect: Array = np.asarray(slope @ amounts)
        if float(residual @ inverse @ effect) > 2.0 * self._settings.limit:  # else it explains nothing
            for _ in range(_MAX_STEPS):
                found = self._effect(signature, newest, np.asarray(amounts))
                if found is None:
                    return None
                effect = found
                step = np.linalg.solve(kept, slope.T @ inverse @ (residual - effect) - amounts)
                if float(np.abs(step).max()) < _SETTLED:
                    break
                amounts = amounts + step
        left = residual - effect
        wider, grown = usual, 0.0
        if not signature.exact:
            samples = newest.samples
            apart = np.zeros((len(residual), 3))
            for axis, rows in enumerate((slice(0, 2 * samples, 2), slice(1, 2 * samples, 2), slice(2 * samples, None))):
                apart[rows, axis] = self._settings.slope_error * effect[rows]
            wider = usual + apart @ apart.T + np.diag((self._settings.slope_error * effect) ** 2)
            grown = float(np.linalg.slogdet(wider)[1] - np.linalg.slogdet(usual)[1])
        remaining = float(left @ np.linalg.solve(wider, left))
        fall = float(residual @ inverse @ residual) - remaining
        log_ratio = 0.5 * (fall - float(amounts @ amounts) - float(np.linalg.slogdet(kept)[1]) - grown)
        shift = float(signature.stddev[0] * amounts[0] * signature.unit)
        if signature.sign * shift < 0.0:
            return None
        size = shift if len(amounts) == 1 else float(np.linalg.norm(signature.stddev * amounts))
        return Explanation(signature.cause, log_ratio, signature.words.format(size), shift), remaining

    def _effect(self, signature: _Signature, newest: _Residual, amounts: Array) -> Array | None:
        """Return what a cause's amounts [prior deviations] change of a closing, (3 K,); None: no equilibrium."""
        amount = float(signature.stddev[0] * amounts[0])
        mean, changed, moved = self._reference.mean, newest.closing, self._reference.mean
        if signature.place is not None:
            moved = mean + amount * np.eye(len(mean))[signature.place]
        elif signature.shortens:
            changed = tuple(
                dataclasses.replace(one, pulled_mm=max(0.0, one.pulled_mm - amount * one.tension_n)) for one in changed
            )
        else:
            return np.asarray(signature.slope @ (signature.stddev * amounts))
        after = Expectation.of(self._causes, moved, changed)
        return None if after is None else after.value - newest.expected

    def _signatures(
        self, closing: Sequence[ClosingInstant], expected: Expectation, conditions: ClosingConditions
    ) -> list[_Signature]:
        causes, prior, n = self._causes, self._causes.prior, self._causes.finger.joints
        factor, zero = causes.factor, causes.zero
        count = len(closing)

        def of(
            cause: Cause, place: int, stddev: float, unit: float, words: str = "{:+.0%}", sign: int = 0
        ) -> _Signature:
            slope = expected.slope[:, place : place + 1]
            return _Signature(cause, slope, np.array([stddev]), place, unit=unit, words=words, sign=sign)

        stiffness = of(self._stiffness_cause(conditions), factor + 1, _STIFFNESS_SD, prior.stiffness)
        found = [
            of(Cause.FRICTION, factor, _FRICTION_SD, prior.friction),
            stiffness,
            of(Cause.ZERO, zero, _ZERO_SD, prior.zero_mm, "{:+.2f} mm"),
            of(Cause.TENSION_GAIN, zero + 2, _GAIN_SD, prior.tension_gain),
            _Signature(
                Cause.CAMERA,
                expected.slope[:, zero + 3 : zero + 7],
                np.array(_CAMERA_SD),
                exact=True,
                words="by {:.1f} sd",
            ),
        ]
        for joint in range(n):
            thickness = causes.finger.thickness_mm[joint]
            words = f"{{:+.0%}} of strip {joint}'s stiffness"
            found.append(
                of(Cause.STRIP, factor + 2 + joint, _STRIP_SD, 3.0 * prior.thickness_mm / thickness, words, sign=-1)
            )
        tension = np.array([sample.predicted_n for sample in closing])
        rate = expected.slope[:, zero] / prior.zero_mm
        stretch = -rate * np.concatenate([np.repeat(tension, 2), tension])
        found.append(
            _Signature(
                Cause.CABLE, stretch[:, None], np.array([_CABLE_SD]), shortens=True, words="{:+.3f} mm/N", sign=1
            )
        )
        foreshortened = np.zeros(3 * count)
        foreshortened[1 : 2 * count : 2] = -expected.value[1 : 2 * count : 2]
        found.append(
            _Signature(
                Cause.OUT_OF_PLANE,
                foreshortened[:, None],
                np.array([_PLANE_SD]),
                exact=True,
                words="{:+.1%} of y",
                sign=1,
            )
        )
        return found

    def _unusual(self, conditions: ClosingConditions) -> str:
        """Return what of a closing's speed and rest is outside the usual, in words; empty: nothing."""
        factor = self._settings.conditions_factor
        for name, words in (("speed_mm_per_s", "{:.1f} mm/s"), ("rest_s", "{:.1f} s of rest")):
            usual = [value for one in self._usual if math.isfinite(value := getattr(one, name))]
            now = getattr(conditions, name)
            if usual and math.isfinite(now) and not min(usual) / factor <= now <= max(usual) * factor:
                return f"{words.format(now)} beside {min(usual):.1f} to {max(usual):.1f}"
        return ""

    def _stiffness_cause(self, conditions: ClosingConditions) -> Cause:
        """Return what a common change of the moduli is, by what is known of how the closing was made."""
        if self._unusual(conditions):
            return Cause.CONDITIONS
        warm = [one.temperature_c for one in self._usual if math.isfinite(one.temperature_c)]
        if warm and abs(conditions.temperature_c - float(np.mean(warm))) > self._settings.temperature_k:
            return Cause.TEMPERATURE
        further = max([conditions.further_mm, *(one.further_mm for _, one in self._latest)])
        return Cause.RUNNING_IN if further > 0.5 else Cause.STIFFNESS
