# SPDX-License-Identifier: Apache-2.0
"""Samples of one empty closing, taken every so much of pulled length, given out when it has ended."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Pulled lengths that differ by less are the same.
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class ClosingInstant:
    """One instant of a closing.

    Attributes:
        stamp: [ns].
        pulled_mm: pulled length.
        tip_mm: (2,) measured.
        tension_n: measured at the actuator.
        predicted_n: tension that the profile's finger has there.
    """

    stamp: int
    pulled_mm: float
    tip_mm: Array
    tension_n: float
    predicted_n: float


@dataclass(frozen=True)
class SamplingRule:
    """Which instants of a closing count.

    Attributes:
        spacing_mm: pulled length between samples.
        min_pulled_mm: shortest pull that is looked at.
        min_samples: of a closing that counts.
    """

    spacing_mm: float = 1.0
    min_pulled_mm: float = 1.0
    min_samples: int = 8


class ClosingCollector:
    """Collects the closings of one finger, one after the other."""

    def __init__(self, rule: SamplingRule) -> None:
        self._rule = rule
        self._samples: list[ClosingInstant] = []

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool) -> tuple[ClosingInstant, ...]:
        """Take one instant; return the samples of the closing that it ends, empty otherwise.

        Args:
            sample: NaN in it is left out.
            pulling: the cable is being pulled.
            free: nothing is held: only then the free model says what to expect.
        """
        if not free:
            self._samples.clear()
            return ()
        if not pulling:
            closing = tuple(self._samples)
            self._samples.clear()
            return closing if len(closing) >= self._rule.min_samples else ()
        furthest_mm = self._samples[-1].pulled_mm if self._samples else 0.0
        next_mm = max(self._rule.min_pulled_mm, furthest_mm + self._rule.spacing_mm)
        known = bool(np.isfinite(sample.tip_mm).all()) and math.isfinite(sample.tension_n)
        if known and sample.pulled_mm >= next_mm - _ROUNDING_MM:
            self._samples.append(sample)
        return ()
