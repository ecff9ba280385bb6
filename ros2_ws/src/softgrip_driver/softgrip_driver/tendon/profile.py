# SPDX-License-Identifier: Apache-2.0
"""Speeds between goals: a setpoint that moves with limited acceleration, and what a drive's own profile needs."""

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

    #: [m] distances below this count as zero
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


class GoalSpeed:
    """The speed at which a drive's own profile goes from goal to goal without standing in between.

    A stiff drive that starts and stops with each goal shows its inertia as tension.

    Args:
        fastest: [rad/s] the drive's own limit, for the first goal.
        slowest: [rad/s] at least, or a creeping goal would never be reached, nor held against a load.
    """

    #: beside the speed of the goals: a drive that is a little late must catch up
    AHEAD = 1.2

    def __init__(self, fastest: float, slowest: float = 0.05) -> None:
        self._fastest, self._slowest = fastest, slowest
        self._last: tuple[float, float] | None = None
        self.speed = fastest

    def restart(self) -> None:
        """Forget the goals of before."""
        self._last, self.speed = None, self._fastest

    def update(self, now: float, goal: float) -> float:
        """Return the speed [rad/s] on the way to a goal [rad] that is sent at a time [s]."""
        last, self._last = self._last, (now, goal)
        if last is not None and goal != last[1] and now > last[0]:
            asked = self.AHEAD * abs(goal - last[1]) / (now - last[0])
            self.speed = max(self._slowest, min(self._fastest, asked))
        return self.speed
