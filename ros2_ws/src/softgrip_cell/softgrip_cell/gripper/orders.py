# SPDX-License-Identifier: Apache-2.0
"""What a gripper goal asks for, checked, and the order to the tendons that it becomes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_cell.errors import RefusedError
from softgrip_description.opening import GripperOpening


@dataclass(frozen=True)
class GripperLimits:
    """What goes with a goal that does not say it, and what no goal may exceed.

    Attributes:
        max_effort_n: tension of each tendon of a goal with effort 0 or none.
        effort_limit_n: largest tension that a goal may ask for.
        max_velocity_m_s: speed of the opening of a goal with none; no goal is faster.
    """

    max_effort_n: float
    effort_limit_n: float
    max_velocity_m_s: float


@dataclass(frozen=True)
class GripperGoal:
    """A goal of control_msgs: opening [m], largest effort [N] and speed [m/s]; 0 = the limits' own."""

    position_m: float
    max_effort_n: float = 0.0
    max_velocity_m_s: float = 0.0


@dataclass(frozen=True)
class TendonOrder:
    """A movement of all tendons: pulled length [m], speed [m/s], tension limit of each [N]."""

    pulled_length_m: float
    speed_m_s: float
    tension_limit_n: float


def parallel_goal(position: Sequence[float], velocity: Sequence[float], effort: Sequence[float]) -> GripperGoal:
    """Return the goal of a ParallelGripperCommand.

    As in ros2_controllers exactly one position is asked for; velocity and effort are optional.

    Raises:
        RefusedError: another number of positions.
    """
    if len(position) != 1:
        raise RefusedError(f"command.position: expected 1 value (the opening [m]), found {len(position)}")
    return GripperGoal(position[0], effort[0] if len(effort) else 0.0, velocity[0] if len(velocity) else 0.0)


def tendon_order(goal: GripperGoal, opening: GripperOpening, limits: GripperLimits, tolerance_m: float) -> TendonOrder:
    """Return the order that fulfils a goal.

    Args:
        goal: as the client sent it.
        opening: of the mounted fingers.
        limits: for what the goal leaves open.
        tolerance_m: an opening that is outside the range by no more than that is taken for the end of the range.

    Raises:
        RefusedError: a number is out of range or not finite; names it and what is allowed.
    """
    low_m, high_m = opening.min_m, opening.max_m
    if not low_m - tolerance_m <= goal.position_m <= high_m + tolerance_m:
        raise RefusedError(
            f"position: expected {low_m:.4f} to {high_m:.4f} m with these fingers, found {goal.position_m:g}"
        )
    if not 0.0 <= goal.max_effort_n <= limits.effort_limit_n:
        raise RefusedError(
            f"max effort: expected 0 (= {limits.max_effort_n:g}) to {limits.effort_limit_n:g} N of each tendon, found "
            f"{goal.max_effort_n:g}"
        )
    if not 0.0 <= goal.max_velocity_m_s < math.inf:
        raise RefusedError(f"velocity: expected 0 (= {limits.max_velocity_m_s:g}) or more m/s, found {goal}")
    speed_m_s = min(goal.max_velocity_m_s or limits.max_velocity_m_s, limits.max_velocity_m_s)
    return TendonOrder(
        pulled_length_m=opening.pulled_length_m(goal.position_m),
        speed_m_s=opening.tendon_speed_m_s(speed_m_s),
        tension_limit_n=goal.max_effort_n or limits.max_effort_n,
    )
