# SPDX-License-Identifier: Apache-2.0
"""Profiles and trajectories against closed forms."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.profile import SpeedProfile
from softgrip_driver.tendon.trajectory import TendonTrajectory


@given(
    st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.002, 0.2), st.floats(0.05, 5.0), st.floats(0.002, 0.02)
)
def test_a_profile_keeps_its_limits_arrives_and_stands(start, target, speed, acceleration, dt):
    profile = SpeedProfile(start)
    # Closed form of a trapezoid, plus one step for each of its corners.
    span = abs(target - start)
    fastest = min(speed, math.sqrt(span * acceleration))
    duration = (span / fastest + fastest / acceleration if fastest > 0.0 else 0.0) * 1.3 + 12 * dt
    before = start
    for _ in range(math.ceil(duration / dt)):
        velocity = profile.velocity
        now = profile.step(target, speed, acceleration, dt)
        assert abs(profile.velocity) <= speed * (1 + 1e-9)
        assert abs(profile.velocity - velocity) <= 2.0 * acceleration * dt * (1 + 1e-9)
        assert abs(now - before) <= speed * dt * (1 + 1e-9) + 2.0 * acceleration * dt * dt
        before = now
    assert profile.position == target
    assert profile.velocity == 0.0


def test_a_profile_takes_the_time_of_its_trapezoid():
    profile, steps = SpeedProfile(0.0), 0
    while profile.position != 0.02:
        profile.step(0.02, 0.02, 0.5, 0.001)
        steps += 1
    assert steps * 0.001 == pytest.approx(0.02 / 0.02 + 0.02 / 0.5, abs=0.005)


def test_straight_lines_join_points_without_speeds():
    path = TendonTrajectory.checked([1.0, 2.0], [0.01, 0.02], [], 0.03, 0.05).starting_from(0.0, 0.0)
    assert path.length(0.5) == pytest.approx(0.005)
    assert path.length(1.5) == pytest.approx(0.015)
    assert path.length(9.0) == 0.02


def test_hermite_reproduces_any_cubic():
    def cubic(t):
        return 0.001 + 0.004 * t + 0.003 * t**2 - 0.001 * t**3

    def slope(t):
        return 0.004 + 0.006 * t - 0.003 * t**2

    times = [0.0, 0.7, 2.0]
    path = TendonTrajectory.checked(times, [cubic(t) for t in times], [slope(t) for t in times], 0.1, math.inf)
    for t in (0.1, 0.35, 0.9, 1.6, 1.99):
        assert path.length(t) == pytest.approx(cubic(t), abs=1e-12)


@pytest.mark.parametrize(
    ("times", "lengths", "speeds", "text"),
    [
        ([], [], [], "0 points"),
        ([0.1, 0.1], [0.0, 0.0], [], "growing times"),
        ([-0.1], [0.0], [], "growing times"),
        ([0.1], [0.2], [], "0 and 0.0300 m"),
        ([0.1], [-0.001], [], "between 0"),
        ([0.1], [math.nan], [], "finite"),
        ([0.1, 0.2], [0.0, 0.0], [0.0], "1 velocities"),
    ],
)
def test_a_bad_trajectory_is_refused_with_what_is_wrong(times, lengths, speeds, text):
    with pytest.raises(ConfigurationError, match=text):
        TendonTrajectory.checked(times, lengths, speeds, 0.03, 0.05)
