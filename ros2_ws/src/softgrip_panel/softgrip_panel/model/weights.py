# SPDX-License-Identifier: Apache-2.0
"""A check of the tension that a driver says, by weights that a person hangs on a tendon."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: [m/s^2], ISO 80000-3
GRAVITY_M_S2: Final = 9.80665
#: Weights beyond these are not hung on a finger's tendon [kg].
MIN_KG, MAX_KG = 0.02, 5.0
#: A weight that swings: the spread of its readings, as a share of it.
MAX_SPREAD: Final = 0.1
#: From the data sheet alone a tension is known to this share (parameter tension_stddev_share of the driver).
SHEET_SHARE: Final = 0.15
MIN_READINGS: Final = 5
MAX_POINTS: Final = 50


@dataclass(frozen=True)
class WeightPoint:
    """One weight: what hangs there, and what the driver says of it."""

    tendon: str
    mass_kg: float
    tension_n: float
    spread_n: float

    @property
    def weight_n(self) -> float:
        """What the tension should be [N]."""
        return self.mass_kg * GRAVITY_M_S2

    @property
    def error(self) -> float:
        """Tension over weight, minus one."""
        return self.tension_n / self.weight_n - 1.0


class WeightCheck:
    """Collects points; the same for every browser."""

    def __init__(self) -> None:
        self.points: tuple[WeightPoint, ...] = ()

    def add_weight(self, tendon: str, mass_kg: float, readings_n: Sequence[float]) -> WeightPoint:
        """Add a weight by the readings of its tendon.

        Raises:
            PanelError: a mass out of range, too few readings, or a weight that swings.
        """
        if not MIN_KG <= mass_kg <= MAX_KG:
            raise PanelError(say("error.weight", low=MIN_KG, high=MAX_KG, found=mass_kg))
        known = [one for one in readings_n if math.isfinite(one)]
        if len(known) < MIN_READINGS:
            raise PanelError(say("error.no_readings", tendon=tendon, found=len(known)))
        spread_n = statistics.stdev(known)
        if spread_n > MAX_SPREAD * mass_kg * GRAVITY_M_S2:
            raise PanelError(say("error.weight_swings", tendon=tendon, spread=spread_n))
        point = WeightPoint(tendon, mass_kg, statistics.fmean(known), spread_n)
        self.points = (*self.points, point)[-MAX_POINTS:]
        return point

    def clear(self) -> None:
        """Begin again."""
        self.points = ()

    def factors(self) -> dict[str, float]:
        """Return what the driver says over what hangs there, by tendon: least squares through zero."""
        found = {}
        for tendon in sorted({one.tendon for one in self.points}):
            own = [one for one in self.points if one.tendon == tendon]
            found[tendon] = sum(one.tension_n * one.weight_n for one in own) / sum(one.weight_n**2 for one in own)
        return found

    def is_good(self, tendon: str) -> bool:
        """Whether a tendon's tension is as true as the data sheet promises."""
        return abs(self.factors()[tendon] - 1.0) <= SHEET_SHARE
