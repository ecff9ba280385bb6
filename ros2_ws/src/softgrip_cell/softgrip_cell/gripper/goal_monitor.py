# SPDX-License-Identifier: Apache-2.0
"""When a gripper goal has ended, and with which flags.

The rules are those of ros2_controllers (branch jazzy, commit ed360c9): ``check_for_success`` of
gripper_controllers/gripper_action_controller_impl.hpp, which is the same in
parallel_gripper_controller/parallel_gripper_action_controller_impl.hpp. So a client sees the same flags from this cell
and from a gripper behind those controllers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class GoalEnd(Enum):
    """How a goal ended: control_msgs' flags ``reached_goal`` and ``stalled``; at most one of them is set."""

    REACHED = "reached"
    STALLED = "stalled"


@dataclass(frozen=True)
class GoalSettings:
    """The parameters of the same names of ros2_controllers.

    Attributes:
        goal_tolerance_m: a smaller position error is none.
        stall_velocity_threshold_m_s: a gripper that is not faster does not move.
        stall_timeout_s: a gripper that has not moved for longer is stalled.
        allow_stalling: a stalled goal succeeds.
    """

    goal_tolerance_m: float = 0.002
    stall_velocity_threshold_m_s: float = 0.001
    stall_timeout_s: float = 1.0
    allow_stalling: bool = True

    def is_success(self, end: GoalEnd) -> bool:
        """Return whether the action succeeds with this end; it is aborted otherwise."""
        return end is GoalEnd.REACHED or self.allow_stalling


class GoalMonitor:
    """Judges one goal, sample by sample.

    Args:
        settings: tolerances and times.
        position_m: the goal's opening.
        start_s: when the goal was accepted.
    """

    def __init__(self, settings: GoalSettings, position_m: float, start_s: float) -> None:
        self._settings = settings
        self._position_m = position_m
        self._last_movement_s = start_s

    def check(self, time_s: float, position_m: float, velocity_m_s: float) -> GoalEnd | None:
        """Return how the goal has ended with this sample, None while it goes on."""
        if abs(self._position_m - position_m) < self._settings.goal_tolerance_m:
            return GoalEnd.REACHED
        if abs(velocity_m_s) > self._settings.stall_velocity_threshold_m_s:
            self._last_movement_s = time_s
        elif time_s - self._last_movement_s > self._settings.stall_timeout_s:
            return GoalEnd.STALLED
        return None
