# SPDX-License-Identifier: Apache-2.0
"""A setpoint that moves with limited speed and acceleration and stops on its target."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class SpeedProfile:
    """Trapezoidal motion of a setpoint.

    Attributes:
        position: [m]
        velocity: [m/s]
    """

    position: float
    velocity: float = 0.0

    #: [m] of way that is none
    POSITION_EPSILON_M = 1e-9

    def step(self, target: float, speed: float, acceleration: float, dt: float) -> float:
        """Advance by ``dt`` [s] towards ``target`` [m] and return the new position [m]."""
        distance = target - self.position
        # Fastest speed from which the rest of the way still suffices to stop, seen at the end of this step.
        stopping = (
            math.sqrt(2.0 * acceleration * abs(distance) + (0.5 * acceleration * dt) ** 2) - 0.5 * acceleration * dt
        )
        requested = math.copysign(min(speed, stopping), distance)
        change = max(-acceleration * dt, min(acceleration * dt, requested - self.velocity))
        self.velocity += change
        moved = self.velocity * dt
        arrives = abs(distance) < self.POSITION_EPSILON_M or (abs(moved) >= abs(distance) and moved * distance >= 0.0)
        if arrives and abs(self.velocity) <= 2.0 * acceleration * dt:
            self.position, self.velocity = target, 0.0
        else:
            self.position += moved
        return self.position

    def stop_at(self, position: float) -> None:
        """Stand at a position."""
        self.position, self.velocity = position, 0.0
