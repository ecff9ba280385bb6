# SPDX-License-Identifier: Apache-2.0
"""The states of a goal (https://design.ros2.org/articles/actions.html) and which goals a cancel request means."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import RCLError

if TYPE_CHECKING:
    from collections.abc import Iterable


class GoalEvent(IntEnum):
    """What moves a goal on; the numbers are rcl_action's."""

    EXECUTE = 0
    CANCEL_GOAL = 1
    SUCCEED = 2
    ABORT = 3
    CANCELED = 4


class Status(IntEnum):
    """action_msgs/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


ACTIVE = frozenset({Status.ACCEPTED, Status.EXECUTING, Status.CANCELING})
_NEXT = {
    (Status.ACCEPTED, GoalEvent.EXECUTE): Status.EXECUTING,
    (Status.ACCEPTED, GoalEvent.CANCEL_GOAL): Status.CANCELING,
    (Status.EXECUTING, GoalEvent.CANCEL_GOAL): Status.CANCELING,
    (Status.EXECUTING, GoalEvent.SUCCEED): Status.SUCCEEDED,
    (Status.EXECUTING, GoalEvent.ABORT): Status.ABORTED,
    (Status.CANCELING, GoalEvent.SUCCEED): Status.SUCCEEDED,
    (Status.CANCELING, GoalEvent.ABORT): Status.ABORTED,
    (Status.CANCELING, GoalEvent.CANCELED): Status.CANCELED,
}


def next_status(status: Status, event: GoalEvent) -> Status:
    """Return the status after an event; RCLError when the event is not possible."""
    if (status, event) not in _NEXT:
        raise RCLError(f"goal_handle attempted invalid transition from state {status.name} with event {event.name}")
    return _NEXT[status, event]


def goals_to_cancel(request: Any, goals: Iterable[Any]) -> tuple[list[Any], int]:
    """Return the goal infos a CancelGoal request means, and the return code.

    Id and stamp zero: all. Id only: that goal. Stamp only: all accepted until then. Both: that goal and those.
    """
    from action_msgs.srv import CancelGoal  # noqa: PLC0415  classes are made on first use

    requested = bytes(request.goal_info.goal_id.uuid)
    stamp = (request.goal_info.stamp.sec, request.goal_info.stamp.nanosec)
    no_id, no_stamp = not any(requested), stamp == (0, 0)
    found = []
    code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID if no_stamp and not no_id else CancelGoal.Response.ERROR_NONE
    for goal in goals:
        is_it = not no_id and bytes(goal.goal_id.uuid) == requested
        accepted = (goal._goal_info.stamp.sec, goal._goal_info.stamp.nanosec)
        by_time = (no_id and no_stamp) or (not no_stamp and accepted <= stamp)
        cancelable = goal.status in {Status.ACCEPTED, Status.EXECUTING}
        if is_it and no_stamp:
            code = CancelGoal.Response.ERROR_NONE if cancelable else CancelGoal.Response.ERROR_GOAL_TERMINATED
        if (is_it or by_time) and cancelable:
            found.append(goal._goal_info)
    return found, code
