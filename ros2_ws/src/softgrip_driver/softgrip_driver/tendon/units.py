# SPDX-License-Identifier: Apache-2.0
"""Between a servo's shaft and a tendon: spool radius for lengths, a torque model with its uncertainty for forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_driver.errors import ConfigurationError

Array = NDArray[np.float64]

#: share of the largest current over which the currents of a calibration must spread to show a slope
MIN_SPREAD = 0.3
#: fewest points of a calibration
MIN_POINTS = 6


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
    """Tension from the winding's current: k i = T r (1 + eta sign v) + k (i_f sign v + s v).

    Attributes:
        torque_per_ampere: k [N m/A] at the horn.
        friction_current: i_f [A] of the gears.
        relative_stddev: uncertainty of k (1 standard deviation).
        source: "data sheet", or where it was calibrated.
        friction_slope: s [A s/m] by which the gears' friction grows with the tendon's speed.
        load_share: eta, the share of the load that presses the gears' teeth and is lost to friction.
        quick_stddev: [N s^2/m^2] by which the uncertainty grows with the square of the speed: quick gears may rub
            otherwise than this model has it.
    """

    torque_per_ampere: float
    friction_current: float
    relative_stddev: float = 0.15
    source: str = "data sheet"
    friction_slope: float = 0.0
    load_share: float = 0.0
    quick_stddev: float = 0.0

    #: [m/s] below this the gears may stand, and friction may act either way
    STANDING_SPEED = 5e-4

    def pull(self, current: float, speed: float, radius: float, current_stddev: float = 0.0) -> tuple[float, float]:
        """Return (force [N], standard deviation [N]) at a current [A, + pulls] and tendon speed [m/s, + pulls].

        A tendon cannot push: a force below zero is an error of the model, and the tension is zero then.
        ``current_stddev`` [A] is that of a current that is estimated itself.
        """
        force_per_ampere = self.torque_per_ampere / radius
        standing = abs(speed) < self.STANDING_SPEED
        direction = 0.0 if standing else math.copysign(1.0, speed)
        friction = direction * self.friction_current + self.friction_slope * speed
        force = force_per_ampere * (current - friction) / (1.0 + direction * self.load_share)
        # Standing gears can hide any force within +- friction: a uniform distribution of that half width.
        hidden = force_per_ampere * self.friction_current * (1.0 / math.sqrt(3.0) if standing else 0.3)
        if standing:
            hidden += self.load_share * abs(force) / math.sqrt(3.0)
        quick = self.quick_stddev * speed**2
        return force, math.hypot(self.relative_stddev * force, hidden, force_per_ampere * current_stddev, quick)

    def current(self, tension: float, radius: float) -> float:
        """Return the current [A] at which a winding drive reaches a tension [N]."""
        load = tension * radius * (1.0 + self.load_share)
        return load / self.torque_per_ampere + self.friction_current


#: ratio of the fastest to the slowest speed from which a calibration shows friction that grows with speed
MIN_SPEED_RATIO = 1.5


def fit_torque_model(
    currents: Sequence[float], speeds: Sequence[float], tensions: Sequence[float], radius: float, source: str
) -> TorqueModel:
    """Fit a torque model to tensions of a load cell by least squares.

    T = (k i - k i_f sign v - k s v - eta T r sign v) / r is linear in all four. A friction that comes out below zero is
    none. Points count by their speed.

    Args:
        currents: [A] of the winding, + pulls.
        speeds: [m/s] + pulls; both directions must occur.
        tensions: [N] of the load cell.
        radius: [m] of the spool.
        source: what to write into the model.

    Raises:
        ConfigurationError: too few points, only one direction, or currents that do not vary.
    """
    i = np.asarray(currents, dtype=float)
    speed = np.asarray(speeds, dtype=float)
    direction = np.sign(speed)
    force = np.asarray(tensions, dtype=float)
    _check_points(i, direction)
    columns: dict[str, Array] = {"current": i, "friction": -direction, "load": -direction * force}
    if np.abs(speed).max() >= MIN_SPEED_RATIO * np.abs(speed).min():
        columns["slope"] = -speed
    # Samples come at even times. Each counts by the way that it stands for, or quick rounds would count for nothing.
    weight = np.sqrt(np.abs(speed) / np.abs(speed).mean())
    columns, values = _least_squares({name: weight * column for name, column in columns.items()}, weight * force)
    slope = float(values[0])
    if slope <= 0.0:
        raise ConfigurationError(
            f"torque model: expected tension that grows with current, found {slope:.3g} N/A; "
            "check the direction sign of the tendon and the sign of the load cell"
        )
    design = np.column_stack(list(columns.values()))
    residual = weight * force - design @ values
    variance = float(residual @ residual) / max(1, len(i) - len(columns))
    steady, quick = _variance_by_speed(residual / weight, speed, weight)
    slope_variance = variance * float(np.linalg.inv(design.T @ design)[0, 0])
    # One number for both: scatter of single readings about the line, relative to the mean force, and the slope's own.
    relative = math.hypot(math.sqrt(steady) / max(float(force.mean()), 1e-6), math.sqrt(slope_variance) / slope)
    found = dict(zip(columns, values.tolist(), strict=True))
    return TorqueModel(
        slope * radius, found.get("friction", 0.0) / slope, relative, source,
        found.get("slope", 0.0) / slope, found.get("load", 0.0), math.sqrt(quick),
    )  # fmt: skip


def _variance_by_speed(left_over: Array, speed: Array, weight: Array) -> tuple[float, float]:
    """Return the variance [N^2] of what a fit leaves over at rest, and how it grows with speed^4 [N^2 s^4/m^4]."""
    squares, counts, growth = left_over**2, weight**2, speed**4
    mean, mean_growth = np.average(squares, weights=counts), np.average(growth, weights=counts)
    spread = float(np.average((growth - mean_growth) ** 2, weights=counts))
    if spread <= 1e-6 * mean_growth**2:  # one speed shows no growth
        return float(mean), 0.0
    quick = max(0.0, float(np.average((squares - mean) * (growth - mean_growth), weights=counts)) / spread)
    return max(0.0, float(mean - quick * mean_growth)), quick


def _least_squares(columns: dict[str, Array], force: Array) -> tuple[dict[str, Array], Array]:
    """Return the columns that count and their values: without frictions below zero or that nothing tells apart."""
    fitted, _, rank, _ = np.linalg.lstsq(np.column_stack(list(columns.values())), force, rcond=None)
    values = np.asarray(fitted, dtype=float)
    frictions = values[1:]
    if not len(frictions) or (rank == len(values) and frictions.min() >= 0.0):
        return columns, values
    left_out = list(columns)[1 + int(np.argmin(frictions)) if rank == len(values) else -1]
    return _least_squares({name: column for name, column in columns.items() if name != left_out}, force)


def _check_points(currents: Array, direction: Array) -> None:
    """Raise ConfigurationError where a recording can not show a torque model."""
    if len(currents) < MIN_POINTS or not ((direction > 0).any() and (direction < 0).any()):
        raise ConfigurationError(
            f"torque model: expected at least {MIN_POINTS} points, some winding in and some paying out, found "
            f"{len(currents)} points ({int((direction > 0).sum())} in, {int((direction < 0).sum())} out); repeat the "
            "calibration"
        )
    spread = max(float(np.ptp(currents[direction == one])) for one in (1.0, -1.0))
    if spread < MIN_SPREAD * np.abs(currents).max():
        raise ConfigurationError(
            "torque model: expected currents from a slack to a taut tendon in each direction, found a spread of only "
            f"{spread:.3f} A up to {np.abs(currents).max():.3f} A; wind in further, or to a higher tension"
        )
