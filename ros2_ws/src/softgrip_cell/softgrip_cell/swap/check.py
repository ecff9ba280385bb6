# SPDX-License-Identifier: Apache-2.0
"""Checking mounted fingers by closing them on nothing: what is measured has to lie where the profile predicts it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softgrip_cell.errors import CatalogueError
from softgrip_cell.grasp.reference import FreeReference, learn_reference
from softgrip_cell.observation import ObservedPair, SeenTip
from softgrip_time.units import to_ns

#: Fewer comparable samples than this prove nothing.
MIN_SAMPLES: Final = 20
#: [m] of pulled length that one value of a course stands for; samples that end farther from the closing's end are lost.
SMOOTH_M: Final = 2.0e-3
#: A groove closes where the prediction rises so many times as steeply as it mostly does. From so far before that place
#: [m] on nothing is compared: nobody knows better where a printed groove closes, and at what length of a worn-in
#: cable.
STOP_STEEPNESS: Final = 4.0
STOP_MARGIN_M: Final = 1.0e-3


@dataclass(frozen=True)
class CheckSettings:
    """The closing and the intervals that it has to lie in.

    Attributes:
        length_m: pulled length of the closing; a finger that meets the tension limit before stops there [m].
        tension_limit_n: tension at which a finger has closed as far as it goes [N].
        speed_m_per_s: of the closing [m/s].
        reach_m: shortest closing that proves anything [m].
        from_m: pulled length from which tensions are compared; below it slack and stretch rule [m].
        tension_fraction: how far measured over predicted tension may be from 1: stiffness of the print, friction and
            the motor's torque constant make it so wide.
        shape_fraction: how far the measured curve may be from the predicted one once their sizes are made equal, as a
            share of the mean tension.
        noise_n: what gears and cogging of a motor add to a tension, however small it is [N].
        change_fraction: how far the tension may be from what it was when the same finger was checked before.
        broken_fraction: measured over predicted tension below which nothing is pulled.
        tip_m: largest distance of the seen from the predicted fingertip, beside the camera's own uncertainty [m].
        pair_s: longest time between a frame and the sample that it is compared with [s].
    """

    length_m: float = 0.020
    tension_limit_n: float = 28.0
    speed_m_per_s: float = 0.012
    reach_m: float = 0.010
    from_m: float = 0.004
    tension_fraction: float = 0.45
    shape_fraction: float = 0.30
    noise_n: float = 0.8
    change_fraction: float = 0.15
    broken_fraction: float = 0.3
    tip_m: float = 0.012
    pair_s: float = 0.05


class Finding(StrEnum):
    """What the check says of one finger."""

    GOOD = "good"
    BROKEN = "broken"  # tendon pulls nothing
    OFF = "off"  # not what its finger record says
    WORN = "worn"  # not any more what it was
    UNSEEN = "unseen"  # too little was measured


@dataclass(frozen=True)
class FingerCheck:
    """Result for one slot.

    Attributes:
        tension_ratio: measured over predicted tension, by least squares [1]; NaN when unseen.
        tip_error_m: median distance of seen and predicted tip [m]; NaN when the camera saw none.
        reference: free motion learned, when the finger is good.
    """

    slot: str
    finding: Finding
    reason: str
    tension_ratio: float
    tip_error_m: float
    reference: FreeReference | None = None


@dataclass(frozen=True)
class _Trace:
    """One finger's closing where it can be compared: pulled length [m], tension measured and predicted [N]."""

    pulled_length_m: NDArray[np.float64]
    measured_n: NDArray[np.float64]
    predicted_n: NDArray[np.float64]

    def smooth(self) -> _Trace:
        """Return the medians over every SMOOTH_M of pulled length, to which one late or noisy sample means nothing."""
        places = np.floor(self.pulled_length_m / SMOOTH_M).astype(int)
        columns = np.stack([self.pulled_length_m, self.measured_n, self.predicted_n])
        return _Trace(*np.array([np.median(columns[:, places == place], axis=1) for place in np.unique(places)]).T)

    def before_stops(self, reach_m: float) -> _Trace:
        """Return the closing up to where the prediction has a groove close, or up to `reach_m` at least."""
        order = np.argsort(self.pulled_length_m)
        lengths = np.arange(self.pulled_length_m.min(), self.pulled_length_m.max(), 0.5 * SMOOTH_M)
        rises = np.diff(np.interp(lengths, self.pulled_length_m[order], self.predicted_n[order]))
        steep = np.flatnonzero(rises > STOP_STEEPNESS * np.median(rises)) if len(rises) else np.zeros(0, dtype=int)
        if not len(steep):
            return self
        free = self.pulled_length_m <= max(float(lengths[steep[0]]) - STOP_MARGIN_M, reach_m)
        return _Trace(self.pulled_length_m[free], self.measured_n[free], self.predicted_n[free])

    @property
    def ratio(self) -> float:
        """Measured over predicted tension, by least squares."""
        return float(self.measured_n @ self.predicted_n / (self.predicted_n @ self.predicted_n))

    @property
    def misfit(self) -> float:
        """RMS of what remains after the predicted curve was scaled, over the mean tension."""
        rest = self.measured_n - self.ratio * self.predicted_n
        return float(np.sqrt(np.mean(rest**2)) / max(float(np.mean(self.measured_n)), 1e-9))

    def change(self, earlier: FreeReference) -> float:
        """Tension now over the tension of an earlier check, by least squares."""
        within = self.pulled_length_m <= earlier.reach_m
        before = np.interp(self.pulled_length_m[within], earlier.pulled_length_m, earlier.tension_n)
        return float(self.measured_n[within] @ before / (before @ before)) if within.any() else math.nan


class EmptyClosing:
    """Collects one empty closing and judges it.

    Args:
        slots: names, in slot order.
        settings: see CheckSettings.
        earlier: per slot, what the last check of this very finger saw; nothing for a finger that is new.
    """

    def __init__(
        self, slots: Sequence[str], settings: CheckSettings, earlier: Mapping[str, FreeReference] | None = None
    ) -> None:
        self._slots = tuple(slots)
        self._settings = settings
        self._earlier = dict(earlier or {})
        self._pairs: list[ObservedPair] = []
        self._tips: list[SeenTip] = []
        self._ended_m: Mapping[str, float] = {}

    def observe(self, pair: ObservedPair) -> None:
        """Take one tendon sample with its prediction, in the order of their stamps."""
        if not self._pairs or pair.sample.stamp_ns > self._pairs[-1].sample.stamp_ns:
            self._pairs.append(pair)

    def observe_tip(self, tip: SeenTip) -> None:
        """Take what the camera saw."""
        self._tips.append(tip)

    def end(self, pulled_length_m: Mapping[str, float]) -> None:
        """Take where each slot was when the closing ended, by the driver [m]: samples have to reach there."""
        self._ended_m = dict(pulled_length_m)

    def judge(self) -> Mapping[str, FingerCheck]:
        """Return what was found, per slot."""
        return {name: self._judge_slot(index, name) for index, name in enumerate(self._slots)}

    def _judge_slot(self, index: int, name: str) -> FingerCheck:
        objections = {pair.free.objection for pair in self._pairs if pair.free.objection}
        if objections:
            return _unseen(name, f"the free motion cannot be predicted: {'; '.join(sorted(objections))}")
        trace, missing = self._trace(index, self._ended_m.get(name, 0.0))
        if missing:
            return _unseen(name, missing)
        tip_m, tip_allowed_m = self._tip_error(index, name)
        course = trace.before_stops(self._settings.reach_m).smooth()
        finding, reason = self._compare(name, course, tip_m, tip_allowed_m)
        if finding is not Finding.GOOD:
            return FingerCheck(name, finding, reason, course.ratio, tip_m)
        try:
            last = self._pairs[-1].free
            reference = learn_reference(
                trace.pulled_length_m, trace.measured_n, trace.predicted_n, last.friction_model, last.friction_digest
            )
        except CatalogueError as error:
            return _unseen(name, str(error))
        return FingerCheck(name, finding, reason, course.ratio, tip_m, reference)

    def _trace(self, index: int, ended_m: float) -> tuple[_Trace, str]:
        """Return a slot's comparable samples, and what is missing for a judgement (empty for nothing)."""
        settings = self._settings
        pulled = np.array([pair.sample.pulled_length_m[index] for pair in self._pairs])
        measured = np.array([pair.sample.tension_n[index] for pair in self._pairs])
        predicted = np.array([pair.free.tension_n[index] for pair in self._pairs])
        # Where the grooves close the predicted tension shoots up: nothing can be compared there. Nor where the finger
        # stands or goes back a little: friction turns round, and the prediction is of a finger that closes.
        closes = np.diff(np.maximum.accumulate(pulled), prepend=-math.inf) > 0.0
        compared = closes & (pulled >= settings.from_m) & (predicted > 0.0) & (predicted < settings.tension_limit_n)
        seen_m = float(pulled.max(initial=0.0))
        samples = int(compared.sum())
        trace = _Trace(pulled[compared], measured[compared], predicted[compared])
        reach_m = float(trace.pulled_length_m.max(initial=0.0))
        if seen_m < ended_m - SMOOTH_M:
            expected = f"expected samples of the whole closing, to {ended_m * 1e3:.1f} mm"
            return trace, f"{expected}, found none beyond {seen_m * 1e3:.1f} mm: they were lost on their way"
        if samples >= MIN_SAMPLES and reach_m >= settings.reach_m:
            return trace, ""
        reasons = sorted({pair.free.objections[index] for pair in self._pairs} - {""})
        found = "; ".join([f"{samples} samples up to {reach_m * 1e3:.1f} mm", *reasons])
        return trace, f"expected a closing to {settings.reach_m * 1e3:.1f} mm or more, found {found}"

    def _compare(self, name: str, trace: _Trace, tip_m: float, tip_allowed_m: float) -> tuple[Finding, str]:
        settings = self._settings
        ratio, misfit = trace.ratio, trace.misfit
        change = trace.change(self._earlier[name]) if name in self._earlier else math.nan
        if ratio < settings.broken_fraction:
            return Finding.BROKEN, f"tension is {ratio:.0%} of the prediction: the cable is broken, unhooked or slack"
        if abs(ratio - 1.0) > settings.tension_fraction:
            low, high = 1.0 - settings.tension_fraction, 1.0 + settings.tension_fraction
            found = f"tension is {ratio:.0%} of the prediction, expected {low:.0%} to {high:.0%}"
            return Finding.OFF, f"{found}: another finger than its finger record says, worn, or jammed"
        allowed = math.hypot(settings.shape_fraction, settings.noise_n / float(np.mean(trace.measured_n)))
        if misfit > allowed:
            found = f"the tension's course is off by {misfit:.0%}, expected at most {allowed:.0%}"
            return Finding.OFF, f"{found}: another finger than its finger record says, or jammed"
        if tip_m > tip_allowed_m:
            found = (
                f"the fingertip is {tip_m * 1e3:.1f} mm from the prediction, expected at most {tip_allowed_m * 1e3:.1f}"
            )
            return Finding.OFF, f"{found} mm: another finger than its finger record says, or worn"
        if abs(change - 1.0) > settings.change_fraction:
            found = f"tension is {change:.0%} of what it was at the last check, expected within"
            return Finding.WORN, f"{found} {settings.change_fraction:.0%}: the finger or its cable is worn"
        seen = f"fingertip within {tip_m * 1e3:.1f} mm" if math.isfinite(tip_m) else "not seen by the camera"
        return Finding.GOOD, f"tension {ratio:.0%} of the prediction, {seen}"

    def _tip_error(self, index: int, name: str) -> tuple[float, float]:
        """Return the median distance of seen and predicted tip, and what is allowed [m]; NaN when nothing was seen."""
        settings = self._settings
        stamps = np.array([pair.sample.stamp_ns for pair in self._pairs])
        distances: list[float] = []
        spreads: list[float] = []
        for tip in self._tips:
            if tip.slot != name or not len(stamps):
                continue
            nearest = int(np.argmin(np.abs(stamps - tip.stamp_ns)))
            pair = self._pairs[nearest]
            if abs(int(stamps[nearest]) - tip.stamp_ns) > to_ns(settings.pair_s):
                continue
            if pair.sample.pulled_length_m[index] < settings.from_m:
                continue
            distances.append(math.dist(tip.tip_m, pair.free.tip_m[index]))
            spreads.append(tip.stddev_m if math.isfinite(tip.stddev_m) else 0.0)
        finite = [distance for distance in distances if math.isfinite(distance)]
        if not finite:
            return math.nan, settings.tip_m
        return float(np.median(finite)), settings.tip_m + 3.0 * float(np.median(spreads))


def _unseen(name: str, reason: str) -> FingerCheck:
    return FingerCheck(name, Finding.UNSEEN, reason, math.nan, math.nan)
