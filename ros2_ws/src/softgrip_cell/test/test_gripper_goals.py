# SPDX-License-Identifier: Apache-2.0
"""Gripper goals: when they end and with which flags, what is refused, and the orders that they become."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softgrip_cell.errors import RefusedError
from softgrip_cell.gripper.goal_monitor import GoalEnd, GoalMonitor, GoalSettings
from softgrip_cell.gripper.orders import GripperGoal, GripperLimits, parallel_goal, tendon_order
from softgrip_description.opening import FingerClearance, GripperOpening

SETTINGS = GoalSettings(goal_tolerance_m=0.002, stall_velocity_threshold_m_s=0.001, stall_timeout_s=0.5)
LIMITS = GripperLimits(max_effort_n=20.0, effort_limit_n=35.0, max_velocity_m_s=0.1)


def monitor(position_m: float = 0.05) -> GoalMonitor:
    return GoalMonitor(SETTINGS, position_m, 10.0)


def test_a_goal_within_the_tolerance_is_reached_at_once_even_while_it_moves() -> None:
    assert monitor().check(10.0, 0.0519, -0.3) is GoalEnd.REACHED


def test_an_error_of_exactly_the_tolerance_is_one() -> None:
    assert GoalMonitor(GoalSettings(goal_tolerance_m=0.25), 1.0, 0.0).check(0.0, 1.25, 0.1) is None


def test_a_gripper_that_stands_is_stalled_only_after_the_timeout() -> None:
    watching = monitor()
    assert watching.check(10.4, 0.06, 0.0) is None
    assert watching.check(10.5, 0.06, 0.0) is None
    assert watching.check(10.51, 0.06, 0.0) is GoalEnd.STALLED


def test_movement_in_either_direction_starts_the_timeout_again() -> None:
    for velocity in (0.0011, -0.0011):
        watching = monitor()
        assert watching.check(10.5, 0.06, velocity) is None
        assert watching.check(11.0, 0.06, 0.0) is None
        assert watching.check(11.01, 0.06, 0.0) is GoalEnd.STALLED


def test_creeping_no_faster_than_the_threshold_is_standing() -> None:
    assert monitor().check(10.6, 0.06, 0.001) is GoalEnd.STALLED


def test_a_gripper_that_arrives_after_standing_for_long_has_reached_its_goal() -> None:
    assert monitor().check(99.0, 0.05, 0.0) is GoalEnd.REACHED


def test_a_stalled_goal_succeeds_only_where_that_is_allowed() -> None:
    assert GoalSettings(allow_stalling=True).is_success(GoalEnd.STALLED)
    assert not GoalSettings(allow_stalling=False).is_success(GoalEnd.STALLED)
    assert GoalSettings(allow_stalling=False).is_success(GoalEnd.REACHED)


@pytest.fixture
def opening() -> GripperOpening:
    """80 mm open, 20 mm after 15 mm pulled; each side moves by 2 mm a millimetre."""
    pulled = np.linspace(0.0, 0.015, 61)
    return GripperOpening({
        "index": FingerClearance(-1, pulled, 0.045 - 2.0 * pulled),
        "thumb": FingerClearance(1, pulled, 0.035 - 2.0 * pulled),
    })  # fmt: skip


def order(goal: GripperGoal, opening: GripperOpening):
    return tendon_order(goal, opening, LIMITS, 0.002)


def test_an_order_pulls_what_the_opening_needs(opening: GripperOpening) -> None:
    found = order(GripperGoal(0.040, max_effort_n=12.0, max_velocity_m_s=0.02), opening)
    assert found.pulled_length_m == pytest.approx(0.010)
    assert found.speed_m_s == pytest.approx(0.005)
    assert found.tension_limit_n == 12.0


def test_what_a_goal_leaves_open_comes_from_the_limits(opening: GripperOpening) -> None:
    found = order(GripperGoal(0.080), opening)
    assert found.pulled_length_m == 0.0
    assert found.speed_m_s == pytest.approx(0.025)
    assert found.tension_limit_n == 20.0


def test_no_goal_is_faster_than_the_limit(opening: GripperOpening) -> None:
    assert order(GripperGoal(0.05, max_velocity_m_s=3.0), opening).speed_m_s == pytest.approx(0.025)


def test_a_goal_just_outside_goes_to_the_end_of_the_range(opening: GripperOpening) -> None:
    assert order(GripperGoal(0.0185), opening).pulled_length_m == pytest.approx(0.015)
    assert order(GripperGoal(0.0815), opening).pulled_length_m == 0.0


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (GripperGoal(0.0), "0.0200 to 0.0800 m"),
        (GripperGoal(0.09), "0.0200 to 0.0800 m"),
        (GripperGoal(math.nan), "position"),
        (GripperGoal(math.inf), "position"),
        (GripperGoal(0.05, max_effort_n=36.0), "35 N"),
        (GripperGoal(0.05, max_effort_n=-1.0), "max effort"),
        (GripperGoal(0.05, max_effort_n=math.nan), "max effort"),
        (GripperGoal(0.05, max_velocity_m_s=-0.1), "velocity"),
        (GripperGoal(0.05, max_velocity_m_s=math.nan), "velocity"),
        (GripperGoal(0.05, max_velocity_m_s=math.inf), "velocity"),
    ],
)
def test_a_goal_out_of_range_is_refused_with_what_is_allowed(
    goal: GripperGoal, words: str, opening: GripperOpening
) -> None:
    with pytest.raises(RefusedError, match=words):
        order(goal, opening)


def test_a_parallel_goal_has_one_position_and_maybe_velocity_and_effort() -> None:
    assert parallel_goal([0.03], [], []) == GripperGoal(0.03)
    assert parallel_goal([0.03], [0.02], [7.0]) == GripperGoal(0.03, max_effort_n=7.0, max_velocity_m_s=0.02)


@pytest.mark.parametrize("count", [0, 2])
def test_a_parallel_goal_with_another_number_of_positions_is_refused(count: int) -> None:
    with pytest.raises(RefusedError, match=f"expected 1 value .* found {count}"):
        parallel_goal([0.03] * count, [], [])
