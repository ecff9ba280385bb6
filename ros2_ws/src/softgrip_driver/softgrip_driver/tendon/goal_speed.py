# SPDX-License-Identifier: Apache-2.0
"""The speed at which a drive's own profile takes it from goal to goal without standing in between.

A stiff drive that starts and stops with each goal shows its inertia as tension.
"""

from __future__ import annotations


class GoalSpeed:
    """Follows the goals of one drive.

    Args:
        fastest: [rad/s] the drive's own limit, for goals that do not move and the first one.
    """

    #: beside the speed of the goals: a drive that is a little late must catch up
    AHEAD = 1.2
    #: [rad/s] at least, or a creeping goal would never be reached
    SLOWEST = 0.05

    def __init__(self, fastest: float) -> None:
        self._fastest = fastest
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
            self.speed = max(self.SLOWEST, min(self._fastest, asked))
        return self.speed
