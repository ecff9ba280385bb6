# SPDX-License-Identifier: Apache-2.0
"""Between a servo's shaft and a tendon: spool radius for lengths, a torque model with its uncertainty for forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softgrip_driver.errors import ConfigurationError

#: share of the largest current over which the currents of a calibration must spread to show a slope
MIN_SPREAD = 0.3


@dataclass(frozen=True)
class Spool:
    """A spool on a shaft.

    Attributes:
        radius: [m] to the centre line of the tendon.
        direction: +1 when a positive shaft rotation winds the tendon in, else -1.
    """

    radius: float
    direction: int

    def __post_init__(self) -> None:
        if not 1e-4 < self.radius < 1.0 or self.direction not in (-1, 1):
            raise ConfigurationError(
                "spool: expected a radius between 0.1 mm and 1 m and a direction of +1 or -1, "
                f"found {self.radius} m and {self.direction}"
            )

    def length(self, angle: float) -> float:
        """Return the tendon wound in [m] at a shaft angle [rad]; also speeds [m/s] from [rad/s]."""
        return self.direction * angle * self.radius

    def angle(self, length: float) -> float:
        """Return the shaft angle [rad] that winds in ``length`` [m]."""
        return self.direction * length / self.radius


@dataclass(frozen=True)
class TorqueModel:
    """Tension from motor current: T = k (i - i_f sign(v)) / r, with gear friction as a current i_f.

    Attributes:
        torque_per_ampere: k [N m/A] at the horn.
        friction_current: i_f [A].
        relative_stddev: uncertainty of k (1 standard deviation).
        source: "data sheet", or where it was calibrated.
    """

    torque_per_ampere: float
    friction_current: float
    relative_stddev: float = 0.15
    source: str = "data sheet"

    #: [m/s] below this the gears may stand, and friction may act either way
    STANDING_SPEED = 5e-4

    def pull(self, current: float, speed: float, radius: float) -> tuple[float, float]:
        """Return (force [N], standard deviation [N]) at a current [A, + pulls] and tendon speed [m/s, + pulls].

        A tendon cannot push: a force below zero is an error of the model, and the tension is zero then.
        """
        force_per_ampere = self.torque_per_ampere / radius
        standing = abs(speed) < self.STANDING_SPEED
        friction = 0.0 if standing else math.copysign(self.friction_current, speed)
        force = force_per_ampere * (current - friction)
        # Standing gears can hide any force within +- friction: a uniform distribution of that half width.
        hidden = force_per_ampere * self.friction_current * (1.0 / math.sqrt(3.0) if standing else 0.3)
        return force, math.hypot(self.relative_stddev * force, hidden)

    def current(self, tension: float, radius: float) -> float:
        """Return the current [A] at which a winding drive reaches a tension [N]."""
        return tension * radius / self.torque_per_ampere + self.friction_current


def fit_torque_model(
    currents: Sequence[float], speeds: Sequence[float], tensions: Sequence[float], radius: float, source: str
) -> TorqueModel:
    """Fit a torque model to tensions of a load cell by least squares.

    Args:
        currents: [A] + pulls.
        speeds: [m/s] + pulls; both directions must occur.
        tensions: [N] of the load cell.
        radius: [m] of the spool.
        source: what to write into the model.

    Raises:
        ConfigurationError: too few points, only one direction, or currents that do not vary.
    """
    i = np.asarray(currents, dtype=float)
    direction = np.sign(np.asarray(speeds, dtype=float))
    force = np.asarray(tensions, dtype=float)
    if len(i) < 6 or not ((direction > 0).any() and (direction < 0).any()):
        raise ConfigurationError(
            f"torque model: expected at least 6 points, some winding in and some paying out, found {len(i)} points "
            f"({int((direction > 0).sum())} in, {int((direction < 0).sum())} out); repeat the calibration"
        )
    spread = max(float(np.ptp(i[direction == one])) for one in (1.0, -1.0))
    if spread < MIN_SPREAD * np.abs(i).max():
        raise ConfigurationError(
            "torque model: expected currents from a slack to a taut tendon in each direction, found a spread of only "
            f"{spread:.3f} A up to {np.abs(i).max():.3f} A; wind in further, or to a higher tension"
        )
    design = np.column_stack((i, -direction))
    (slope, friction_force), _, rank, _ = np.linalg.lstsq(design, force, rcond=None)
    if rank < 2 or slope <= 0.0:
        raise ConfigurationError(
            f"torque model: expected tension that grows with current, found {slope:.3g} N/A; "
            "check the direction sign of the tendon and the sign of the load cell"
        )
    residual = force - design @ np.array([slope, friction_force])
    variance = float(residual @ residual) / (len(i) - 2)
    slope_variance = variance * float(np.linalg.inv(design.T @ design)[0, 0])
    # One number for both: scatter of single readings about the line, relative to the mean force, and the slope's own.
    relative = math.hypot(math.sqrt(variance) / max(float(force.mean()), 1e-6), math.sqrt(slope_variance) / slope)
    return TorqueModel(float(slope) * radius, max(0.0, float(friction_force / slope)), relative, source)
