# SPDX-License-Identifier: Apache-2.0
"""What has changed about a finger? Likelihood ratios of causes over its empty closings (docs/finger.md).

The first closings of a finger set what is known of it (`Knowledge`), how closings go and how they scatter. Later ones
are compared with the calm ones before: their mean difference is put down to each cause in turn (`hypotheses`), and what
a hand's fingers share to heat (`hand`). Before any cause is named, the difference has to be too large to be chance, and
what the cause leaves of it small enough; otherwise it is "none of these". The ratio of one cause to the next has to be
large, or both are named. Only a cause that is wear calls a finger worn.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger.closing_difference import ClosingDifference, ClosingResidual, ClosingScatter
from softgrip_model.finger.closing_samples import ClosingCollector, ClosingInstant
from softgrip_model.finger.hand import Softening, log_odds_of_heat
from softgrip_model.finger.hypotheses import Cause, OwnClosing, Weighed, hypotheses, proportional, weigh
from softgrip_model.finger.learning import SAMPLING, Expectation, Knowledge, measured
from softgrip_model.finger.uncertainty import STATED, Causes
from softgrip_model.finger.wear import LEARNING, WearVerdict
from softgrip_time.units import to_s

Array = NDArray[np.float64]

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

#: What a common change of the moduli may be.
_SOFTENINGS = {Cause.STIFFNESS, Cause.TEMPERATURE, Cause.CONDITIONS, Cause.RUNNING_IN}

#: What the finger that a watch compares with may differ in: as stated, for other printers and cables than those that
#: tolerances were corrected by, too. Its first closings tell where the cable lies.
WATCHED = dataclasses.replace(STATED, room_mm=0.0, room_share=0.0, scatter_mm=0.05)

#: Calm closings that scatter can be estimated from.
_MIN_CALM = 4
#: [mm] beyond all closings before from which a finger runs in.
_FURTHER_MM = 0.5
#: Share of the expected tension below which a tendon is slack, and taut samples without which slack ones count, too.
_SLACK, _MIN_TAUT = 0.1, 6


@dataclass(frozen=True)
class WatchSettings:
    """When a change is called one.

    Attributes:
        baseline: closings that set what is known before the first verdict.
        settled: calm closings after which the baseline stays as it is, so that slow changes are not taken in.
        windows: so many latest closings are averaged, each in turn, 1 among them: a large change shows at once, a small
            one in the mean of many.
        steady_limit: standard deviations by which a window's closings may differ among themselves; others have no mean.
        limit: log-likelihood ratio of a cause to no change from which there is one.
        worn_limit: the same for calling a finger worn.
        margin: of a cause to the next from which it alone is named.
        misfit_limit: standard deviations that what a cause leaves may exceed its expectation by,
        misfit_share: or share of what has changed that it may leave: no kernel follows a large change to the end.
        model_errors: how far the kernel's answer to a cause may be off, relative; which of them holds is unknown.
        expected_odds: logarithm of the odds of softer or stiffer strips, beside other causes, where a closing's speed,
            rest, heat or history lets one expect so; against them where nothing does, half where heat is unknown.
        worn_friction: friction shift from which cable or channel are worn.
        conditions_factor: speeds and rests beyond the baseline's range by this factor are unusual.
        temperature_k: change from which the temperature is one.
    """

    baseline: int = 5
    settled: int = 12
    windows: tuple[int, ...] = (1, 2, 5, 12)
    steady_limit: float = 3.0
    limit: float = 6.0
    worn_limit: float = 15.0
    margin: float = 3.0
    misfit_limit: float = 6.0
    misfit_share: float = 0.10
    model_errors: tuple[float, ...] = (0.05, 0.20, 0.50)
    expected_odds: float = 3.0
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
class _Found:
    """What some closings say: each cause weighed, squared residuals in standard deviations, how many there are."""

    weighed: tuple[Weighed, ...] = ()
    squared: float = 0.0
    count: int = 1

    @property
    def beyond_chance(self) -> float:
        """Squared residuals beyond chance."""
        return self.squared - self.count

    @property
    def misfit(self) -> float:
        """The same, in standard deviations."""
        return self.misfit_of(self.squared) if self.squared else 0.0

    def misfit_of(self, remaining: float) -> float:
        """Return by how many standard deviations squared residuals that remain exceed chance."""
        return (remaining - self.count) / math.sqrt(2.0 * self.count)


class CauseWatch:
    """Watches one mounted finger under one friction model; make a new one when either changes."""

    def __init__(self, causes: Causes, settings: WatchSettings) -> None:
        self._causes, self._settings = causes, settings
        self._collector = ClosingCollector(SAMPLING)
        self._reference = Knowledge.prior(causes)
        self._first: list[tuple[ClosingInstant, ...]] = []
        self._calm: list[ClosingResidual] = []
        self._usual: list[ClosingConditions] = []
        self._latest: deque[tuple[ClosingResidual, ClosingConditions]] = deque(maxlen=max(settings.windows))
        self._ended: int | None = None
        self._furthest_mm = self._further_mm = 0.0
        self.closings = 0
        """Closings that counted."""
        self._found = _Found()
        self._before: tuple[Cause, ...] = ()
        self._ran_in = False
        self._others: tuple[CauseWatch, ...] = ()

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool, temperature_c: float = math.nan) -> None:
        """Take one instant; `ClosingCollector.add` has the arguments."""
        closing = self._collector.add(sample, pulling=pulling, free=free)
        if closing:
            self.add_closing(closing, self._conditions(closing, temperature_c))
            self._ended = sample.stamp

    def add_closing(self, closing: tuple[ClosingInstant, ...], conditions: ClosingConditions) -> Diagnosis:
        """Take one closing; return what it says with those before."""
        self.closings += 1
        if self.closings <= self._settings.baseline:
            self._first.append(closing)
            self._usual.append(conditions)
            self._reference = self._reference.learnt(closing)
            if self.closings == self._settings.baseline:
                found = [self._residual(one) for one in self._first]
                self._calm = [one for one in found if one is not None]
            return self.diagnosis
        self._ran_in = self._ran_in or conditions.further_mm > _FURTHER_MM
        residual = self._residual(closing)
        if residual is None or len(self._calm) < _MIN_CALM:
            return self.diagnosis
        self._latest.append((residual, conditions))
        self._before, self._found = self.diagnosis.causes, self._weigh()
        if not self.diagnosis.explanations and len(self._calm) < self._settings.settled:
            self._calm.append(residual)
            self._usual.append(conditions)
        return self.diagnosis

    def join(self, others: Sequence[CauseWatch]) -> None:
        """Record the watches of the hand's other fingers."""
        self._others = tuple(others)

    @property
    def diagnosis(self) -> Diagnosis:
        """What the last closing says, with those before, and with the other fingers' last ones."""
        settings, found = self._settings, self._found
        weighed = sorted((self._in_the_hand(one) for one in found.weighed), key=lambda one: -one.log_ratio)
        if not weighed or weighed[0].log_ratio < settings.limit:
            if found.misfit > settings.misfit_limit:
                return self._unexplained(0.5 * found.beyond_chance, "", found.misfit)
            unusual = self._now_unusual()
            return Diagnosis((Explanation(Cause.CONDITIONS, 0.0, unusual, 0.0),)) if unusual else Diagnosis()
        best = weighed[0]
        misfit = found.misfit_of(best.remaining)
        if misfit > max(settings.misfit_limit, settings.misfit_share * found.misfit):
            return self._unexplained(best.log_ratio, f"(nearest: {best.hypothesis.cause} {best.words})", misfit)
        named: dict[Cause, Explanation] = {}
        for one in weighed:
            if one.log_ratio > best.log_ratio - settings.margin:
                cause = one.hypothesis.cause
                named.setdefault(cause, Explanation(cause, one.log_ratio, one.words, float(one.amounts[0])))
        return Diagnosis(tuple(named.values()), misfit)

    def _unexplained(self, log_ratio: float, words: str, misfit: float) -> Diagnosis:
        """Return a change that no cause fits: a finger closed as never before may close in a way never seen."""
        unusual = self._now_unusual()
        cause = Cause.CONDITIONS if unusual else Cause.NONE_OF_THESE
        return Diagnosis((Explanation(cause, log_ratio, unusual or words, misfit),), misfit)

    @property
    def softening(self) -> Softening | None:
        """What a common change of the strips' moduli would be; None: not known yet."""
        return next((one.softening for one in self._found.weighed if one.hypothesis.cause in _SOFTENINGS), None)

    def _in_the_hand(self, weighed: Weighed) -> Weighed:
        """Return a cause as the other fingers make it likely: what they share is heat."""
        others = [one for other in self._others if (one := other.softening) is not None]
        if not others or weighed.hypothesis.cause not in {Cause.STIFFNESS, Cause.TEMPERATURE}:
            return weighed
        odds = log_odds_of_heat(weighed.softening, others, float(weighed.hypothesis.stddev[0]))
        expected = self._settings.expected_odds
        if odds > 0.0:
            return weighed.known(Cause.TEMPERATURE, expected + odds)
        return weighed.known(Cause.STIFFNESS, -expected)

    def judge(self) -> tuple[WearVerdict, str]:
        """Return the verdict and what follows from it, in words."""
        if self.closings < self._settings.baseline:
            return WearVerdict.OK, f"{LEARNING}: closing {self.closings} of {self._settings.baseline}"
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

    def _residual(self, closing: tuple[ClosingInstant, ...]) -> ClosingResidual | None:
        expected = Expectation.of(self._causes, self._reference.mean, closing)
        if expected is None:
            return None
        causes, prior = self._causes, self._causes.prior
        places, units = (
            [causes.zero, causes.factor + 1, causes.factor],
            [prior.zero_mm, prior.stiffness, prior.friction],
        )
        tension_n = np.array([sample.tension_n for sample in closing])
        taut = np.flatnonzero(tension_n > _SLACK * expected.value[2 * len(closing) :])
        return ClosingResidual(
            np.array([sample.pulled_mm for sample in closing]),
            np.array([sample.predicted_n for sample in closing]),
            measured(closing) - expected.value,
            expected.slope[:, places] / np.array(units),
            int(taut[0]) if len(taut) else 0,
        )

    def _weigh(self) -> _Found:
        """Weigh all causes by whichever has changed most: the last closing, or any window of steady ones."""
        counts = sorted({min(count, len(self._latest)) for count in self._settings.windows})
        differences = [self._difference(count) for count in counts]
        change = max((one for one in differences if one is not None), key=lambda one: one.beyond_chance)
        own = OwnClosing(self._causes, self._reference.mean, change.pulled_mm, change.tension_n, change.usual)
        softening = self._softening()
        # no larger than by chance: no cause can be likely, but the other fingers ask for the softening
        quiet = change.beyond_chance < 0.0
        causes = [proportional(own, *softening)] if quiet else hypotheses(own, *softening)
        weighed = [weigh(one, change.residual, change.root, self._settings.model_errors) for one in causes]
        return _Found(tuple(one for one in weighed if one is not None), change.squared, len(change.residual))

    def _difference(self, count: int) -> ClosingDifference | None:
        """Return how the last ``count`` closings differ from the calm ones; None where they differ among themselves."""
        latest = [one for one, _ in self._latest][-count:]
        end = min(one.samples for one in (*latest, *self._calm))
        # a slack tendon shows how the finger rests, not how it closes
        taut = max(one.slack for one in latest)
        first = taut if end - taut >= _MIN_TAUT else 0
        calm, latest = ([one.between(first, end) for one in each] for each in (self._calm, latest))
        found = ClosingDifference.of(ClosingScatter.of(calm), len(calm), latest)
        return found if found.spread <= self._settings.steady_limit else None

    def _now_unusual(self) -> str:
        """Return `_unusual` of the latest closing."""
        return self._unusual(self._latest[-1][1]) if self._latest else ""

    def _unusual(self, conditions: ClosingConditions) -> str:
        """Return what of a closing's speed and rest is outside the usual, in words; empty: nothing."""
        factor = self._settings.conditions_factor
        for name, words in (("speed_mm_per_s", "{:.1f} mm/s"), ("rest_s", "{:.1f} s of rest")):
            usual = [value for one in self._usual if math.isfinite(value := getattr(one, name))]
            now = getattr(conditions, name)
            if usual and math.isfinite(now) and not min(usual) / factor <= now <= max(usual) * factor:
                return f"{words.format(now)} beside {min(usual):.1f} to {max(usual):.1f}"
        return ""

    def _softening(self) -> tuple[Cause, float]:
        """Return what a common change of the moduli is, by how the last closing was made, and its log odds."""
        conditions, expected = self._latest[-1][1], self._settings.expected_odds
        if self._now_unusual():
            return Cause.CONDITIONS, expected
        if self._ran_in:
            return Cause.RUNNING_IN, expected
        warm = [one.temperature_c for one in self._usual if math.isfinite(one.temperature_c)]
        warmer_k = conditions.temperature_c - float(np.mean(warm)) if warm else math.nan
        if math.isnan(warmer_k):
            return Cause.STIFFNESS, 0.5 * expected
        heat = abs(warmer_k) > self._settings.temperature_k
        return (Cause.TEMPERATURE, expected) if heat else (Cause.STIFFNESS, -expected)
