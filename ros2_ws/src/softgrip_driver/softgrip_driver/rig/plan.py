# SPDX-License-Identifier: Apache-2.0
"""Which points to measure, and in which order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softgrip_driver.errors import ConfigurationError
from softgrip_model.friction.calibration import Calibration
from softgrip_model.friction.design import next_best
from softgrip_model.friction.laws import GRAVITY

#: Wrap angles [deg] and masses [kg] of the thesis' 45 tests, and of the nine it recommends (Table 3.3).
ALL_ANGLES_DEG = tuple(float(a) for a in range(10, 91, 10))
ALL_LOADS_KG = (0.2, 0.4, 0.6, 0.8, 1.0)
NINE_ANGLES_DEG = (10.0, 50.0, 90.0)
NINE_LOADS_KG = (0.2, 0.6, 1.0)
#: Names of the plans that the action accepts.
NINE, FORTY_FIVE, ADAPTIVE, CUSTOM, PULLEY = "9", "45", "adaptive", "custom", "pulley"
PLANS = (NINE, FORTY_FIVE, ADAPTIVE, CUSTOM, PULLEY)
#: [rad], [kg] what a rig of this kind can be set to.
LARGEST_ANGLE = np.pi
LARGEST_LOAD = 5.0


@dataclass(frozen=True)
class Point:
    """One setting: wrap angle [rad], hung mass [kg]."""

    angle: float
    load: float

    def __str__(self) -> str:
        return f"{np.degrees(self.angle):g} deg, {self.load * 1e3:g} g"


def grid(angles_deg: tuple[float, ...], loads_kg: tuple[float, ...]) -> tuple[Point, ...]:
    """Return all settings, one angle after the other: weights are quicker to change than the angle."""
    return tuple(Point(float(np.radians(a)), load) for a in angles_deg for load in loads_kg)


def points_of(plan: str, angles: tuple[float, ...] = (), loads: tuple[float, ...] = ()) -> tuple[Point, ...]:
    """Return a plan's points; for "adaptive" those it begins with.

    Args:
        plan: one of `PLANS`.
        angles: [rad] of a custom plan, one per point.
        loads: [kg] of a custom plan, one per point.

    Raises:
        ConfigurationError: no such plan, or custom points that do not match or that no rig can be set to.
    """
    if plan == NINE:
        return grid(NINE_ANGLES_DEG, NINE_LOADS_KG)
    if plan == FORTY_FIVE:
        return grid(ALL_ANGLES_DEG, ALL_LOADS_KG)
    if plan == ADAPTIVE:
        ends = grid((NINE_ANGLES_DEG[0], NINE_ANGLES_DEG[-1]), (NINE_LOADS_KG[0], NINE_LOADS_KG[-1]))
        return (*ends, *grid(NINE_ANGLES_DEG[1:2], NINE_LOADS_KG[1:2]))
    if plan == PULLEY:
        return grid((0.0,), NINE_LOADS_KG)
    if plan != CUSTOM:
        raise ConfigurationError(f"plan: expected one of {', '.join(PLANS)}, found '{plan}'")
    if len(angles) != len(loads) or len(angles) < 4:
        raise ConfigurationError(
            f"custom plan: expected as many angles as loads, at least 4, found {len(angles)} and {len(loads)}"
        )
    for index, (angle, load) in enumerate(zip(angles, loads, strict=True), 1):
        if not (0.0 < angle <= LARGEST_ANGLE and 0.0 < load <= LARGEST_LOAD):
            raise ConfigurationError(
                f"custom plan, point {index}: expected 0 < angle <= 180 deg and 0 < load <= {LARGEST_LOAD:g} kg, "
                f"found {np.degrees(angle):g} deg and {load:g} kg"
            )
    return tuple(Point(angle, load) for angle, load in zip(angles, loads, strict=True))


def next_point(calibration: Calibration) -> Point:
    """Return the point of the 45-point grid that makes the law's interval smallest soonest (D-optimal, one step)."""
    candidates = grid(ALL_ANGLES_DEG, ALL_LOADS_KG)
    best = next_best(
        calibration.fit.law,
        calibration.fit.slopes,
        np.array([p.angle for p in candidates]),
        np.array([p.load * GRAVITY for p in candidates]),
    )
    return candidates[best]
