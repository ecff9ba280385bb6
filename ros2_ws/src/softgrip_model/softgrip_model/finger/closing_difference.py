# SPDX-License-Identifier: Apache-2.0
"""How much a finger's closings differ from the calm ones before, beside how much these differ among themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]

#: Smallest scatter of closings that is believed: tips [mm], tensions [1], pull [mm], stiffness, friction [1].
_MIN_TIP_MM, _MIN_TENSION, _MIN_PULL_MM, _MIN_STIFFNESS, _MIN_FRICTION = 0.1, 0.01, 0.02, 0.01, 0.02


@dataclass(frozen=True, eq=False)
class ClosingResidual:
    """Measured less expected of a closing with K samples, and what may change it.

    Attributes:
        pulled_mm, tension_n: (K,) pulled length, tension that the profile's finger has there.
        value: (3 K,), tips x and y one after the other, then tensions.
        wandering: (3 K, 3) slopes to the pull [mm], the stiffness and the friction [1]: these differ a little from
            closing to closing.
        slack: samples before the tendon became taut.
    """

    pulled_mm: Array
    tension_n: Array
    value: Array
    wandering: Array
    slack: int

    @property
    def samples(self) -> int:
        """K."""
        return len(self.tension_n)

    def between(self, first: int, end: int) -> ClosingResidual:
        """Return that of some of the samples."""
        tips = 2 * self.samples
        rows, part = [*range(2 * first, 2 * end), *range(tips + first, tips + end)], slice(first, end)
        return ClosingResidual(self.pulled_mm[part], self.tension_n[part], self.value[rows], self.wandering[rows], 0)


@dataclass(frozen=True, eq=False)
class ClosingScatter:
    """Mean of calm closings' residuals, and the covariance of one more closing about it."""

    mean: Array
    covariance: Array

    @classmethod
    def of(cls, calm: Sequence[ClosingResidual]) -> ClosingScatter:
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


@dataclass(frozen=True, eq=False)
class ClosingDifference:
    """Mean of some closings beside the calm ones, with K samples.

    Attributes:
        pulled_mm, tension_n: (K,) of the newest of them.
        usual: (3 K,) mean residual of the calm ones,
        residual: and what these differ from it by.
        root: (3 K, 3 K) lower triangular: root root' is the covariance of chance.
        squared: differences in standard deviations, squared.
        spread: standard deviations that the closings' parts along their mean differ by beyond chance: a change that
            grows, or has not been there all along, has no mean.
    """

    pulled_mm: Array
    tension_n: Array
    usual: Array
    residual: Array
    root: Array
    squared: float
    spread: float

    @classmethod
    def of(cls, usual: ClosingScatter, calm: int, latest: Sequence[ClosingResidual]) -> ClosingDifference:
        """Compare closings with the scatter of so many calm ones."""
        values, count, newest = np.array([one.value for one in latest]), len(latest), latest[-1]
        root = np.asarray(np.linalg.cholesky(usual.covariance), np.float64)
        white = np.asarray(solve_triangular(root, (values - usual.mean).T, lower=True))
        mean = white.mean(axis=1)
        along = mean @ white / max(float(np.linalg.norm(mean)), 1e-12)
        chance = count - 1
        spread = (float(along.var()) * count - chance) / math.sqrt(2.0 * chance) if chance else 0.0
        deviation = math.sqrt(1.0 / count + 1.0 / calm)
        squared = float(mean @ mean) / deviation**2
        residual = values.mean(axis=0) - usual.mean
        return cls(newest.pulled_mm, newest.tension_n, usual.mean, residual, deviation * root, squared, spread)

    @property
    def beyond_chance(self) -> float:
        """Squared differences beyond chance."""
        return self.squared - len(self.residual)
