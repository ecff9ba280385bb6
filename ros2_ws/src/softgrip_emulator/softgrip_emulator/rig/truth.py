# SPDX-License-Identifier: Apache-2.0
"""What is really so on the emulated rig, drawn from a seed: the cable's friction, and what spoils its measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: Ranges that each quantity is drawn from, evenly. They hold what the four pairs of thesis Table 3.2 give at 2 to 10 N:
#: the parts that grow with the wrap are met by pressure coefficients of 0.00, 0.07, 0.10 and 0.18 with shear strengths
#: of 0.8, 0.6, 1.0 and 1.0 MPa, those at no wrap by bending losses of 0.06 to 0.11 N and of 1 to 2 %.
_PRESSURE_COEFFICIENT = (0.02, 0.18)
_SHEAR_STRENGTH_PA = (0.55e6, 1.05e6)
_BENDING_N = (0.06, 0.11)
_BENDING_SHARE = (0.005, 0.02)

#: Cable of 0.25 mm; printed TPU of 21.9 MPa (thesis section 3.2.2) and Poisson's ratio 0.45 against a stiff cable.
_CABLE_RADIUS_M = 0.125e-3
_CONTACT_MODULUS_PA = 21.89e6 / (1.0 - 0.45**2)
#: Below this wrap angle a cable is not bent round the edge but lies beside it [rad].
_BENT_FROM_RAD = 0.05


@dataclass(frozen=True)
class FrictionTruth:
    """How the cable really slides over printed TPU: adhesion that grows with the area of contact, and bending losses.

    A polymer's interface shears at tau = tau_0 + a p (B. J. Briscoe and D. Tabor, Wear 34 (1975) 29). The cable presses
    with T / r a metre on a strip as wide as Hertz' line contact makes it, w = 4 sqrt(R T / (pi E' r)). So

        dT/dtheta = a T + tau_0 r w = a T + c sqrt(T),   c = 4 tau_0 sqrt(R r / (pi E')),

    which sqrt(T) solves in closed form. Bending the cable round the edge and straightening it again costs a constant
    and a share of the tension each (rope stiffness; J. A. Eytelwein, Handbuch der Statik fester Koerper, 1808). It is
    not the law that a calibration fits (thesis Eq 3.9), so even without noise a fit is not exactly right.

    Attributes:
        pressure_coefficient: a [1].
        shear_strength_pa: tau_0.
        bending_n: lost in bending, and in straightening. bending_share: as a share of the tension.
        radius_m: of the surface to the middle of the cable.
    """

    pressure_coefficient: float
    shear_strength_pa: float
    bending_n: float
    bending_share: float
    radius_m: float

    @classmethod
    def from_seed(cls, seed: int, radius_mm: float = 3.125) -> FrictionTruth:
        """Draw a cable on a surface; the default radius is the braid of 0.25 mm on the rig's 3 mm surface."""
        rng = np.random.default_rng([seed, 0x4652])
        ranges = (_PRESSURE_COEFFICIENT, _SHEAR_STRENGTH_PA, _BENDING_N, _BENDING_SHARE)
        pressure, shear_pa, bending_n, bending_share = (float(rng.uniform(*ends)) for ends in ranges)
        return cls(pressure, shear_pa, bending_n, bending_share, 1e-3 * radius_mm)

    @property
    def adhesion(self) -> float:
        """The constant c of the law [sqrt(N)]."""
        contact = np.sqrt(_CABLE_RADIUS_M * self.radius_m / (np.pi * _CONTACT_MODULUS_PA))
        return float(4.0 * self.shear_strength_pa * contact)

    def ratio(self, angle: ArrayLike, tension_low: ArrayLike) -> NDArray[np.float64]:
        """Return the true Rf = T1/T2 at wrap angles [rad] and low tensions [N]."""
        low = np.asarray(tension_low, dtype=np.float64)
        wrap = np.asarray(angle, dtype=np.float64)
        bent = 1.0 - np.exp(-wrap / _BENT_FROM_RAD)
        before = low + bent * (self.bending_n + self.bending_share * low)
        half = 0.5 * self.pressure_coefficient * wrap
        root = np.sqrt(before) * np.exp(half) + self.adhesion / self.pressure_coefficient * np.expm1(half)
        high = root**2
        return np.asarray((high + bent * (self.bending_n + self.bending_share * high)) / low)

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
        gauge_gain: the gauge's calibration error as a factor.
        gauge_noise: standard deviation of a reading [N]. Assumption: one digit of a Mark-10 M5-10, 1/5000 of 50 N
            (mark-10.com, Capacity x Resolution).
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
