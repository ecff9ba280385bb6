# SPDX-License-Identifier: Apache-2.0
"""The 1 euro filter: steady at rest, quick in motion (Casiez et al., CHI 2012, doi 10.1145/2207676.2208639)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

#: Cut-off of the slope's own filter [Hz], as the authors use it.
SLOPE_CUTOFF_HZ: Final = 1.0


@dataclass(frozen=True)
class OneEuroSettings:
    """How much is smoothed.

    Attributes:
        min_cutoff_hz: at rest; lower shakes less.
        speed_factor: cut-off gained for each unit of the signal a second [Hz s / unit]; higher lags less.
    """

    min_cutoff_hz: float = 1.5
    speed_factor: float = 2.0


class OneEuroFilter:
    """Smooths one signal."""

    def __init__(self, settings: OneEuroSettings) -> None:
        self._settings = settings
        self._time_s = self._value = self._slope = math.nan

    def filter(self, time_s: float, value: float) -> float:
        """Return the smoothed value; times have to grow, and one that does not changes nothing."""
        if math.isnan(self._value):
            self._time_s, self._value, self._slope = time_s, value, 0.0
            return value
        step_s = time_s - self._time_s
        if step_s <= 0.0:
            return self._value
        slope = (value - self._value) / step_s
        self._slope += _share(SLOPE_CUTOFF_HZ, step_s) * (slope - self._slope)
        cutoff_hz = self._settings.min_cutoff_hz + self._settings.speed_factor * abs(self._slope)
        self._value += _share(cutoff_hz, step_s) * (value - self._value)
        self._time_s = time_s
        return self._value


def _share(cutoff_hz: float, step_s: float) -> float:
    """Return how much of a change a first-order low pass takes over within a step."""
    return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff_hz * step_s))
