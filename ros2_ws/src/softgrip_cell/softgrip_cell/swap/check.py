# SPDX-License-Identifier: Apache-2.0
"""Checking mounted fingers by closing them on nothing: what is measured has to lie where the profile predicts it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_cell.errors import CatalogueError
from softgrip_cell.grasp.reference import FreeReference, learn_reference
from softgrip_cell.observation import Pair, SeenTip


@dataclass(frozen=True)
class CheckSettings:
    """Intervals of the check.

    Attributes:
        length_m: pulled length of the closing; a finger that meets the tension limit before stops there [m].
        tension_limit_n: tension at which a finger has closed as far as it goes [N].
        reach_m: shortest closing that proves anything [m].
        speed_m_per_s: of the closing [m/s].
        from_m: pulled length from which tensions are compared; below it slack and stretch rule [m].
        tension_fraction: half width of the interval about the predicted tension, as a share of it: stiffness of the
            print, friction and torque constant together.
        tension_floor_n: and never narrower than this [N].
        broken_fraction: measured over predicted tension below which nothing is pulled.
        tip_m: largest distance of the seen from the predicted fingertip, beside the camera's own uncertainty [m].
        pair_s: longest time between a frame and the sample that it is compared with [s].
    """

    length_m: float = 0.020
    tension_limit_n: float = 28.0
    reach_m: float = 0.010
    speed_m_per_s: float = 0.012
    from_m: float = 0.004
    tension_fraction: float = 0.25
    tension_floor_n: float = 0.6
    broken_fraction: float = 0.3
    tip_m: float = 0.008
    pair_s: float = 0.05


class Finding(StrEnum):
    """What the check says of one finger."""

    GOOD = "good"
    BROKEN = "broken"  # tendon pulls nothing
    OFF = "off"  # not what its passport says, or worn
    UNSEEN = "unseen"  # too little was measured


@dataclass(frozen=True)
class FingerCheck:
    """Result for one slot.

    Attributes:
        tension_ratio: median of measured over predicted tension [1]; NaN when unseen.
        tip_error_m: median distance of seen and predicted tip [m]; NaN when the camera saw none.
        reference: free motion learned, when the finger is good.
    """

    slot: str
    finding: Finding
    reason: str
    tension_ratio: float
    tip_error_m: float
    reference: FreeReference | None = None


class EmptyClosing:
    """Collects one empty closing and judges it."""

    def __init__(self, slots: Sequence[str], settings: CheckSettings) -> None:
        self._slots = tuple(slots)
        self._settings = settings
        self._pairs: list[Pair] = []
        self._tips: list[SeenTip] = []

    def observe(self, pair: Pair) -> None:
        """Take one tendon sample with its prediction, in the order of their stamps."""
        if not self._pairs or pair.sample.stamp_ns > self._pairs[-1].sample.stamp_ns:
            self._pairs.append(pair)

    def see(self, tip: SeenTip) -> None:
        """Take what the camera saw."""
        self._tips.append(tip)

    def judge(self) -> Mapping[str, FingerCheck]:
        """Return what was found, per slot."""
        return {name: self._judge_slot(index, name) for index, name in enumerate(self._slots)}

    def _judge_slot(self, index: int, name: str) -> FingerCheck:
        settings = self._settings
        objections = {pair.free.objection for pair in self._pairs if pair.free.objection}
        if objections:
            return _unseen(name, f"the free motion cannot be predicted: {'; '.join(sorted(objections))}")
        pulled = np.array([pair.sample.pulled_m[index] for pair in self._pairs])
        measured = np.array([pair.sample.tension_n[index] for pair in self._pairs])
        predicted = np.array([pair.free.tension_n[index] for pair in self._pairs])
        compared = (pulled >= settings.from_m) & np.isfinite(predicted) & (predicted > 0.0)
        reach_m = float(pulled[compared].max(initial=0.0))
        if np.count_nonzero(compared) < 10 or reach_m < settings.reach_m:
            reasons = sorted({pair.free.objections[index] for pair in self._pairs} - {""})
            found = "; ".join([f"{np.count_nonzero(compared)} samples up to {reach_m * 1e3:.1f} mm", *reasons])
            return _unseen(name, f"expected a closing to {settings.reach_m * 1e3:.1f} mm or more, found {found}")
        ratio = float(np.median(measured[compared] / predicted[compared]))
        tip_m, tip_allowed_m = self._tip_error(index, name)
        finding, reason = Finding.GOOD, ""
        if ratio < settings.broken_fraction:
            finding = Finding.BROKEN
            reason = f"tension is {ratio:.0%} of the prediction: the cable is broken, unhooked or slack"
        elif self._outside(measured[compared], predicted[compared]) > 0.5:
            finding = Finding.OFF
            reason = (
                f"tension is {ratio:.0%} of the prediction, expected within {settings.tension_fraction:.0%} of it: "
                "another finger than its passport says, worn, or jammed"
            )
        elif tip_m > tip_allowed_m:
            finding = Finding.OFF
            reason = (
                f"the fingertip is {tip_m * 1e3:.1f} mm from the prediction, expected at most "
                f"{tip_allowed_m * 1e3:.1f} mm: another finger than its passport says, or worn"
            )
        if finding is not Finding.GOOD:
            return FingerCheck(name, finding, reason, ratio, tip_m)
        try:
            model = self._pairs[-1].free.friction_model
            reference = learn_reference(list(pulled), list(measured), list(predicted), model)
        except CatalogueError as error:
            return _unseen(name, str(error))
        reason = f"tension {ratio:.0%} of the prediction" + (
            f", fingertip within {tip_m * 1e3:.1f} mm" if math.isfinite(tip_m) else ", not seen by the camera"
        )
        return FingerCheck(name, Finding.GOOD, reason, ratio, tip_m, reference)

    def _outside(self, measured: NDArray[np.float64], predicted: NDArray[np.float64]) -> float:
        """Return the share of samples outside the interval about the prediction."""
        settings = self._settings
        allowed = np.maximum(settings.tension_floor_n, settings.tension_fraction * predicted)
        return float(np.mean(np.abs(measured - predicted) > allowed))

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
            if abs(int(stamps[nearest]) - tip.stamp_ns) > settings.pair_s * 1e9:
                continue
            if pair.sample.pulled_m[index] < settings.from_m:
                continue
            distances.append(math.dist(tip.tip_m, pair.free.tip_m[index]))
            spreads.append(tip.stddev_m if math.isfinite(tip.stddev_m) else 0.0)
        finite = [distance for distance in distances if math.isfinite(distance)]
        if not finite:
            return math.nan, settings.tip_m
        return float(np.median(finite)), settings.tip_m + 3.0 * float(np.median(spreads))


def _unseen(name: str, reason: str) -> FingerCheck:
    return FingerCheck(name, Finding.UNSEEN, reason, math.nan, math.nan)
