# SPDX-License-Identifier: Apache-2.0
"""Each motion on made-up views of its drive: how far its set-point goes, with what tension, and when it is over."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import (
    DriveObservation,
    Follow,
    Hold,
    Motion,
    MotionStep,
    MoveOutcome,
    MoveToLength,
    MoveToTension,
)
from softgrip_driver.tendon.profile import SpeedProfile
from softgrip_driver.tendon.trajectory import TendonTrajectory

LIMITS = TendonLimits()
DT = 0.005
HERE = 0.010


def view(
    now: float = 0.0, length: float = HERE, tension: float = 0.0, cap: float = 35.0, **others: float
) -> DriveObservation:
    values = {"speed": 0.0, **others}
    return DriveObservation(now, DT, length, values.pop("speed"), tension, tension, cap, **values)


def to_length(target: float, limit: float = 20.0, speed: float = 0.02, **others: float) -> MoveToLength:
    start = others.pop("start", None)
    return MoveToLength(target, speed, limit, view(**others), LIMITS, start=start)


def to_tension(target: float, **others: float) -> MoveToTension:
    return MoveToTension(target, 0.02, view(**others), LIMITS)


def follow(points: list[float], times: list[float], limit: float = 20.0, **others: float) -> Follow:
    trajectory = TendonTrajectory.checked(times, points, [], LIMITS.travel, LIMITS.speed)
    return Follow(trajectory, limit, view(**others), LIMITS)


def standing(motion: Motion, seconds: float, **seen: float) -> list[MotionStep]:
    """Steps of a motion whose drive does not move, until it is over."""
    steps = []
    for number in range(1, round(seconds / DT) + 1):
        steps.append(motion.step(view(number * DT, **seen)))
        if steps[-1].outcome is not None:
            break
    return steps


def obeyed(motion: Motion, seconds: float, **seen: float) -> list[MotionStep]:
    """Steps of a motion whose drive is always where its set-point was, until it is over."""
    steps = [motion.step(view(DT, **seen))]
    for number in range(2, round(seconds / DT) + 1):
        if steps[-1].outcome is not None:
            break
        steps.append(motion.step(view(number * DT, length=steps[-1].pulled_length_m, **seen)))
    return steps


# --- tension -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("cap", "allowed"), [(35.0, 12.0), (7.0, 7.0)])
def test_no_motion_pulls_with_more_than_it_was_allowed_or_heat_allows(cap: float, allowed: float) -> None:
    motions = [Hold(HERE, 12.0), to_length(0.02, 12.0), follow([0.02], [1.0], 12.0), to_tension(12.0)]
    assert [motion.step(view(DT, cap=cap)).tension_limit for motion in motions] == [allowed] * 4


@pytest.mark.parametrize("motion", [to_length(0.03, 10.0), follow([0.03], [2.0], 10.0)], ids=["move", "stream"])
def test_a_tension_limit_is_met_after_30_ms_of_it(motion: Motion) -> None:
    """0.1 s are given to the motor to get up to speed."""
    for number in range(1, 21):
        assert motion.step(view(number * DT)).outcome is None
    ends = [motion.step(view(0.1 + number * DT, tension=10.0)).outcome for number in range(1, 8)]
    assert ends == [None] * 6 + [MoveOutcome.TENSION_LIMIT]


def test_one_wild_sample_meets_no_limit() -> None:
    motion = to_length(0.03, 10.0)
    for number in range(1, 60):
        tension = 30.0 if number % 10 == 0 else 1.0
        assert motion.step(view(number * DT, length=HERE + 1e-4 * number, tension=tension)).outcome is None


def test_what_a_motor_takes_to_get_up_to_speed_meets_no_limit() -> None:
    """20 mm/s at 0.5 m/s^2 take 40 ms, and 30 ms more make it sure."""
    motion = to_length(0.03, 10.0)
    met = next(number * DT for number in range(1, 40) if motion.step(view(number * DT, tension=20.0)).outcome)
    assert met == pytest.approx(0.070, abs=DT)


@pytest.mark.parametrize("motion", [to_length(0.03, 10.0), to_tension(10.0)], ids=["length", "tension"])
def test_what_inertia_takes_is_no_tension_of_the_tendon(motion: Motion) -> None:
    for number in range(1, 60):
        seen = view(number * DT, length=HERE + 1e-4 * number, tension=20.0, acceleration=1.0)
        assert motion.step(seen).outcome is None


def test_a_taut_finger_opens_though_it_pulls_with_more_than_its_limit() -> None:
    steps = obeyed(to_length(0.0, 10.0), 2.0, tension=15.0)
    assert steps[-1].outcome is MoveOutcome.REACHED


# --- how far a set-point goes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "motion", [to_length(0.03), to_tension(20.0), follow([0.03], [0.5])], ids=["length", "tension", "stream"]
)
def test_a_set_point_does_not_run_away_from_a_finger_that_is_held_up(motion: Motion) -> None:
    """6 mm of lead, and what one step of 5 ms makes at 50 mm/s."""
    ahead = [step.pulled_length_m - HERE for step in standing(motion, 0.6, tension=1.0)]
    assert 0.004 < max(ahead) < LIMITS.max_following_error + LIMITS.speed * DT + 1e-9


def test_a_set_point_that_is_far_ahead_can_be_taken_back() -> None:
    motion = to_length(0.0, start=0.020)
    first, *_, last = standing(motion, 0.2)
    assert last.pulled_length_m < first.pulled_length_m - 1e-3


def test_a_pull_to_a_tension_ends_at_the_travel_and_a_release_at_zero() -> None:
    wound_in = [step.pulled_length_m for step in obeyed(to_tension(20.0), 10.0, tension=0.0)]
    assert max(wound_in) == pytest.approx(LIMITS.travel, abs=1e-6)
    paid_out = [step.pulled_length_m for step in obeyed(to_tension(5.0, tension=20.0), 10.0, tension=20.0)]
    assert min(paid_out) == pytest.approx(0.0, abs=1e-6)


def test_a_stream_that_jumps_is_followed_at_the_speed_limit() -> None:
    lengths = [step.pulled_length_m for step in obeyed(follow([HERE, 0.03, 0.03], [0.0, 0.01, 2.0]), 0.5)]
    fastest = max((b - a) / DT for a, b in pairwise(lengths))
    assert fastest == pytest.approx(LIMITS.speed, rel=0.01)


@pytest.mark.parametrize(("ahead", "begins"), [(0.002, 0.002), (-0.002, -0.002), (0.050, 0.006), (-0.050, -0.006)])
def test_a_new_order_goes_on_from_the_set_point_but_not_from_farther_than_the_lead(ahead: float, begins: float) -> None:
    """A set-point that falls back to the drive would let go of what it holds."""
    for motion in (to_length(0.03, ahead=ahead), to_tension(5.0, ahead=ahead), follow([0.03], [2.0], ahead=ahead)):
        assert motion.step(view(1e-6, tension=5.0)).pulled_length_m == pytest.approx(HERE + begins, abs=2e-4)


def test_the_next_message_of_a_stream_goes_on_from_the_set_point_of_the_one_before() -> None:
    first = follow([0.02], [0.5])
    last = standing(first, 0.2)[-1].pulled_length_m
    second = follow([0.02], [0.3], now=0.2)
    second.take_over(first)
    assert last > HERE + 2e-3
    assert second.step(view(0.2 + DT)).pulled_length_m == pytest.approx(last, abs=3e-4)


def test_a_set_point_that_was_stopped_starts_from_rest() -> None:
    profile = SpeedProfile(0.0)
    for _ in range(50):
        profile.step(0.03, 0.05, 0.5, DT)
    profile.stop_at(0.004)
    # From rest at 0.5 m/s^2: 12.5 um in the first 5 ms.
    assert profile.step(0.03, 0.05, 0.5, DT) - 0.004 == pytest.approx(0.5 * DT * DT)


# --- when it is over -----------------------------------------------------------------------------------------------


def test_a_finger_that_passes_by_has_not_arrived() -> None:
    motion = to_length(0.012)
    assert motion.step(view(DT, length=0.012)).outcome is None, "its set-point is not there"
    arrived = to_length(HERE)
    arrived.step(view(DT))
    assert arrived.step(view(2 * DT, speed=0.02)).outcome is None, "it moves"
    assert arrived.step(view(3 * DT)).outcome is MoveOutcome.REACHED


def test_a_finger_that_is_held_up_short_of_its_target_has_stalled_and_not_arrived() -> None:
    """5 mm short: the set-point arrives after some 0.3 s; standing for 0.4 s more is a stall."""
    last = standing(to_length(0.015), 2.0, tension=3.0)[-1]
    assert (last.outcome, last.fault) == (MoveOutcome.FAULT, "stalled")


def test_a_tension_has_to_stay_for_60_ms() -> None:
    motion = to_tension(8.0)
    ends = [motion.step(view(number * DT, tension=8.0)).outcome for number in range(1, 15)]
    assert ends == [None] * 12 + [MoveOutcome.REACHED] * 2


def test_a_tension_that_can_not_be_had_ends_as_a_stall() -> None:
    last = standing(to_tension(20.0), 3.0, tension=1.0)[-1]
    assert (last.outcome, last.fault) == (MoveOutcome.FAULT, "stalled")


def test_a_stream_into_an_obstacle_stalls_however_often_it_is_sent_anew() -> None:
    """A message each tenth of a second; 0.4 s of standing with the set-point at its lead are a stall."""
    motion = follow([0.03], [0.5])
    for number in range(1, 400):
        now = number * DT
        if number % 20 == 0:
            successor = follow(
                [0.03], [0.5], now=now - 0.5 * DT, ahead=LIMITS.max_following_error
            )  # it came between two cycles
            successor.take_over(motion)
            motion = successor
        step = motion.step(view(now, tension=1.0, ahead=LIMITS.max_following_error))
        if step.outcome is not None:
            break
    assert (step.outcome, step.fault) == (MoveOutcome.FAULT, "stalled")


# --- trajectories --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", range(3))
@pytest.mark.parametrize("place", range(2))
def test_no_number_of_a_trajectory_may_be_none(column: int, place: int, value: float) -> None:
    columns = [[1.0, 2.0], [0.01, 0.02], [0.0, 0.01]]
    columns[column][place] = value
    with pytest.raises(ConfigurationError):
        TendonTrajectory.checked(*columns, LIMITS.travel, LIMITS.speed)
    columns[column] = [[1.0, 2.0], [0.01, 0.02], [0.0, 0.01]][column]
    assert TendonTrajectory.checked(*columns, LIMITS.travel, LIMITS.speed).duration == 2.0
