# SPDX-License-Identifier: Apache-2.0
"""What is really so on the emulated rig, drawn from a seed: the cable's friction, and what spoils its measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from softgrip_model.friction.laws import FrictionLaw, KReading, Law

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: Range that each coefficient is drawn from, evenly: around the pairs of Table 3.2 and chapter 4, none of them exactly.
_ALPHA = (0.12, 0.33)
_N = (0.50, 0.83)
_EPSILON = (0.06, 0.18)
#: lambda as a share of epsilon: 0.13 to 0.36 there, which lets the surface term vanish beyond the measured loads only.
_LAMBDA_SHARE = (0.12, 0.37)


@dataclass(frozen=True)
class FrictionTruth:
    """How the cable really slides: the exact integral of dT/dtheta = alpha r^(1-n) T^n, and a surface term.

    The calibration fits another reading of that law (K as printed), so that even without noise it is not exactly right.

    Attributes:
        law: coefficients and radius.
    """

    law: FrictionLaw

    @classmethod
    def from_seed(cls, seed: int, radius_mm: float = 3.125) -> FrictionTruth:
        """Draw a cable on a surface; the default radius is the braid of 0.25 mm on the rig's 3 mm surface."""
        rng = np.random.default_rng([seed, 0x4652])
        alpha, n, epsilon, share = (float(rng.uniform(*ends)) for ends in (_ALPHA, _N, _EPSILON, _LAMBDA_SHARE))
        return cls(FrictionLaw(Law.MATTE, (alpha, n, epsilon, share * epsilon), radius_mm, KReading.EXACT))

    def ratio(self, angle: ArrayLike, tension_low: ArrayLike) -> NDArray[np.float64]:
        """Return the true Rf = T1/T2 at wrap angles [rad] and low tensions [N]."""
        return self.law.ratio(angle, tension_low)

    def tension_low(self, angle: float, tension_high: float) -> float:
        """Return the low tension [N] that a high one leaves behind the surface (bisection on a rising function)."""
        if tension_high <= 0.0:
            return 0.0
        low, high = 0.0, tension_high
        for _ in range(60):
            middle = 0.5 * (low + high)
            if middle * float(self.ratio(angle, middle)) < tension_high:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)


@dataclass(frozen=True)
class RigTruth:
    """What spoils a measurement on this rig.

    Attributes:
        friction: of cable and surface.
        pulley_ratio: tension ratio over the guide pulley between surface and gauge [1].
        angle_stddev: of setting the angle by hand [rad].
        repeatability: relative scatter of one and the same point [1]: the cable never lies the same way twice.
        load_stddev: relative error of the weights [1].
        stick_slip: half the relative amplitude of the saw-tooth [1].
        waviness: relative amplitude of the layer lines' slow waves [1].
        cable_stiffness: of cable, gauge and frame in series [N/m].
        gauge_gain: the gauge's calibration error as a factor. gauge_noise: [N] standard deviation.
    """

    friction: FrictionTruth
    pulley_ratio: float = 1.012
    angle_stddev: float = float(np.radians(0.5))
    repeatability: float = 0.015
    load_stddev: float = 0.001
    stick_slip: float = 0.008
    waviness: float = 0.004
    cable_stiffness: float = 3000.0
    gauge_gain: float = 1.0
    gauge_noise: float = 0.01

    @classmethod
    def from_seed(cls, seed: int, radius_mm: float = 3.125) -> RigTruth:
        """Draw a rig and a cable."""
        rng = np.random.default_rng([seed, 0x5249])
        return cls(
            friction=FrictionTruth.from_seed(seed, radius_mm),
            pulley_ratio=float(rng.uniform(1.004, 1.020)),
            # The braids of Table 3.1 are 1.1-1.7 % off their fit on average: a standard deviation of 1.3-2.1 %.
            repeatability=float(rng.uniform(0.012, 0.020)),
            stick_slip=float(rng.uniform(0.004, 0.012)),
            waviness=float(rng.uniform(0.002, 0.006)),
            cable_stiffness=float(rng.uniform(2000.0, 4000.0)),
            gauge_gain=float(1.0 + 0.001 * rng.uniform(-1.0, 1.0)),
        )
