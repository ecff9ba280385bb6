# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of `Uncertainty` from the first closings of fingers: stated ones, corrected by what was seen.

Each finger's deviations are drawn from the same distribution, whose widths are looked for: those that make the tips of
all first closings likeliest (empirical Bayes), with the deviations themselves integrated out about the likeliest.
Tensions are left out, since what a motor reads says little of a tip. A stated width counts as much as one finger would
(unit information: Kass and Wasserman, J. Am. Stat. Assoc. 90 (1995) 928), so that no width is fitted to chance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.learning import Expectation, Knowledge
from softgrip_model.finger.uncertainty import MODEL_KNOTS_MM, Causes, Uncertainty

Array = NDArray[np.float64]

#: Widths that are looked for; strips and routing points are printed by one printer.
_SCALES = (
    ("friction",),
    ("stiffness",),
    ("thickness_mm", "routing_mm"),
    ("zero_mm",),
    ("stretch_mm_per_n",),
    ("room_mm",),
    ("model",),
)
#: Standard deviation of the share of its room that a cable takes, beside the stated one.
_SHARE_SD = 0.2
#: Logarithms of widths beside the stated ones, and shares of the room, are looked for in so much.
_SCALE_RANGE, _SHARE_RANGE = (-3.0, 1.5), (-0.5, 0.5)
#: Times that closings are linearised again with the widths found.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class _Tips:
    """Tips of a closing with K samples as they depend on deviations: y = slope z + noise.

    Attributes:
        seen: (2 K,) [mm], less what does not depend on z. slope: (2 K, N) per standard deviation of the causes' prior.
        noise: (2 K, 2 K).
    """

    causes: Causes
    seen: Array
    slope: Array
    noise: Array

    @classmethod
    def of(cls, causes: Causes, closing: Sequence[ClosingInstant]) -> _Tips:
        """Linearise a closing about the likeliest deviations."""
        z = Knowledge.prior(causes).learnt(closing).mean
        expected = Expectation.of(causes, z, closing)
        if expected is None:
            raise FingerError("a closing's likeliest finger has no equilibrium")
        tips = slice(0, 2 * len(closing))
        seen = np.array([sample.tip_mm for sample in closing]).ravel()
        slope = expected.slope[tips]
        return cls(causes, seen - expected.value[tips] + slope @ z, slope, expected.noise[tips, tips])

    def misfit(self, prior: Uncertainty) -> float:
        """Return minus the logarithm of the tips' marginal likelihood under other widths."""
        was, n = self.causes.prior, self.causes.finger.joints
        factor = np.ones(self.slope.shape[1])
        for name, places in _places(self.causes, n).items():
            factor[places] = getattr(prior, name) / getattr(was, name)
        mean, covariance = self.causes.expected
        mean, slope = mean.copy(), self.slope * factor
        moved = np.array(self.causes.room_mm or 0.0).mean() * (prior.room_share - was.room_share)
        mean[self.causes.room] += moved / prior.room_mm
        root = np.linalg.cholesky(slope @ covariance @ slope.T + self.noise)
        left = solve_triangular(root, self.seen - slope @ mean, lower=True)
        return float(0.5 * left @ left + np.log(np.diag(root)).sum())


def _places(causes: Causes, joints: int) -> dict[str, slice]:
    """Return where the deviations of each width stand."""
    factor, room = causes.factor, causes.room
    return {
        "friction": slice(factor, factor + 1),
        "stiffness": slice(factor + 1, factor + 2),
        "thickness_mm": slice(factor + 2, factor + 2 + joints),
        "routing_mm": slice(factor + 2 + joints, causes.zero),
        "zero_mm": slice(causes.zero, causes.zero + 1),
        "stretch_mm_per_n": slice(causes.stretch, causes.stretch + 1),
        "room_mm": slice(room, room + 1),
        "model": slice(room + 1, room + 1 + 2 * len(MODEL_KNOTS_MM)),
    }


def calibrated(
    stated: Uncertainty, fingers: Sequence[tuple[Causes, Sequence[ClosingInstant]]], worth: float = 1.0
) -> Uncertainty:
    """Return the stated standard deviations as the first closings of fingers correct them.

    Args:
        stated: what is believed before any finger was seen.
        fingers: what each may differ in, and its first empty closing.
        worth: fingers that a stated width counts as.

    Raises:
        FingerError: a closing that no finger makes.
    """

    def at(x: Array) -> Uncertainty:
        scales = {
            name: getattr(stated, name) * math.exp(one)
            for one, names in zip(x[:-1], _SCALES, strict=True)
            for name in names
        }
        return dataclasses.replace(stated, **scales, room_share=stated.room_share + float(x[-1]))

    x = np.zeros(len(_SCALES) + 1)
    for _ in range(_ROUNDS):
        now = at(x)
        seen = [_Tips.of(dataclasses.replace(causes, prior=now), closing) for causes, closing in fingers]

        def cost(x: Array, seen: Sequence[_Tips] = tuple(seen)) -> float:
            scales, share = x[:-1], float(x[-1])
            # of a scaled inverse chi-square distribution with `worth` degrees of freedom about the stated width
            believed = worth * float((scales + 0.5 * np.exp(-2.0 * scales)).sum()) + 0.5 * (share / _SHARE_SD) ** 2
            return believed + sum(one.misfit(at(x)) for one in seen)

        bounds = [_SCALE_RANGE] * len(_SCALES) + [_SHARE_RANGE]
        x = np.asarray(minimize(cost, x, method="L-BFGS-B", bounds=bounds).x, np.float64)
    return at(x)
