# SPDX-License-Identifier: Apache-2.0
"""The kernel's inverse as a table: how far to pull a tendon for a finger's joints to add up to a deflection."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError
from softgrip_model.finger import Control, Finger, Kernel, Status
from softgrip_model.friction.laws import FrictionLaw

Array = NDArray[np.float64]

#: Rows of the table; between them lengths are interpolated (a degree or so apart).
ROWS = 181


@dataclass(frozen=True)
class TendonBounds:
    """What a target may ask for at most: pulled length [m] and predicted tension in free motion [N]."""

    max_length_m: float = 0.018
    max_tension_n: float = 15.0


class TendonTable:
    """Deflection of a finger to pulled length, as far as the bounds allow."""

    def __init__(self, finger: Finger, law: FrictionLaw, bounds: TendonBounds) -> None:
        """Solve the finger from open to closed.

        Args:
            finger: that is mounted.
            law: friction of its tendon.
            bounds: where the table ends.

        Raises:
            DesignError: the bounds leave nothing of the closing.
        """
        reach_rad = sum(finger.opening_rad) - finger.joints * finger.stop_margin_rad
        deflections = np.linspace(0.0, reach_rad, ROWS)[1:]
        solution = Kernel([finger], law).solve(deflections, Control.DEFLECTION, threads=1)
        pulled_length_m, tension_n = 1e-3 * solution.pulled_mm[0], solution.tension_n[0, :, 0]
        outside = solution.failed[0] | (solution.status[0] & Status.STOP_ENGAGED != 0)
        outside |= ~(pulled_length_m <= bounds.max_length_m) | ~(tension_n <= bounds.max_tension_n)
        rows = int(outside.argmax()) if outside.any() else len(outside)
        if rows < 2 or np.any(np.diff(pulled_length_m[:rows]) <= 0.0):
            raise DesignError(
                f"expected a finger that closes within {1e3 * bounds.max_length_m:g} mm and {bounds.max_tension_n:g} "
                "N, found none; raise --max-length or --max-tension, or check the profile"
            )
        self._deflections = np.r_[0.0, deflections[:rows]]
        self._pulled_length_m = np.r_[0.0, pulled_length_m[:rows]]

    @property
    def max_deflection_rad(self) -> float:
        """Largest deflection that the bounds allow."""
        return float(self._deflections[-1])

    def length_m(self, deflection_rad: float) -> float:
        """Return the pulled length for a deflection; below and above the table its ends.

        Raises:
            DesignError: a deflection that is not a number.
        """
        if not math.isfinite(deflection_rad):
            raise DesignError(f"expected a deflection, found {deflection_rad}")
        return float(np.interp(deflection_rad, self._deflections, self._pulled_length_m))
