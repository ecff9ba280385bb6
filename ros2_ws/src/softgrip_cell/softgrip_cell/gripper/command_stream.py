# SPDX-License-Identifier: Apache-2.0
"""Positions that a controller commands again and again: which of them is an order.

ros2_control says its command in every cycle, also while nobody asks it for anything: a controller that has just become
active commands where the gripper stands, and one that had a goal an hour ago commands that still. So the first position
that is heard is no order, and later ones are where they change.
"""

from __future__ import annotations

import math

from softgrip_cell.errors import RefusedError
from softgrip_cell.gripper.orders import GripperGoal

#: A stream of positions becomes an order at most so often [s], and after so much change [m].
STREAM_PERIOD_S, STREAM_STEP_M = 0.05, 0.0005


class CommandStream:
    """What was commanded last.

    Attributes:
        changed_s: when it changed last.

    Args:
        tolerance_m: a position that is no further from where the gripper stands asks for nothing.
    """

    def __init__(self, tolerance_m: float) -> None:
        self.changed_s = -math.inf
        self._tolerance_m = tolerance_m
        self._goal: GripperGoal | None = None

    def is_order(self, goal: GripperGoal, standing_m: float, *, owned: bool, busy: bool, now_s: float) -> bool:
        """Take a command and return whether the hand has to move.

        Args:
            goal: that is commanded.
            standing_m: where the gripper stands.
            owned: the tendons are ours already: it moves by this stream.
            busy: an action goal is going on.
            now_s: steady time.

        Raises:
            RefusedError: it would move the hand and must not; said once, not in every cycle.
        """
        before = self._goal
        if before is not None and not self._differs(goal, before, now_s):
            return False
        self._goal, self.changed_s = goal, now_s
        if not owned and abs(goal.position_m - standing_m) <= self._tolerance_m:
            return False
        if before is None:
            raise RefusedError(
                f"position: the first one heard asks for {goal.position_m:.4f} m, the gripper stands at "
                f"{standing_m:.4f} m; the next one that differs is carried out"
            )
        if busy:
            raise RefusedError("position: an action goal goes first; command another one after it")
        return True

    def _differs(self, goal: GripperGoal, before: GripperGoal, now_s: float) -> bool:
        is_other = abs(goal.position_m - before.position_m) >= STREAM_STEP_M or goal.max_effort_n != before.max_effort_n
        return is_other and now_s - self.changed_s >= STREAM_PERIOD_S
