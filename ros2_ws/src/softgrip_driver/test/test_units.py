# SPDX-License-Identifier: Apache-2.0
"""Lengths and forces between shaft and tendon."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.units import Spool, TorqueModel, fit_torque_model


def test_one_turn_winds_in_one_circumference():
    assert Spool(0.010, 1).length(2.0 * math.pi) == pytest.approx(2.0 * math.pi * 0.010)
    assert Spool(0.010, -1).length(2.0 * math.pi) == pytest.approx(-2.0 * math.pi * 0.010)


@given(st.floats(-1.0, 1.0), st.floats(0.002, 0.1), st.sampled_from([-1, 1]))
def test_length_and_angle_are_inverse(length, radius, direction):
    spool = Spool(radius, direction)
    assert spool.length(spool.angle(length)) == pytest.approx(length, abs=1e-15)


@pytest.mark.parametrize(("radius", "direction"), [(0.0, 1), (0.01, 0), (0.01, 2), (2.0, 1), (math.nan, 1)])
def test_an_impossible_spool_is_refused(radius, direction):
    with pytest.raises(ConfigurationError, match="expected"):
        Spool(radius, direction)


def test_stall_torque_of_the_data_sheet_gives_its_tension():
    # XL330-M288: 0.52 N m at 1.47 A; r = 10 mm: 52 N (hardware notes, motor ratings), less the gears' friction.
    model = TorqueModel(0.52 / 1.47, 0.0)
    force, _ = model.pull(1.47, 0.05, 0.010)
    assert force == pytest.approx(52.0)


@given(st.floats(0.1, 40.0))
def test_the_current_limit_for_a_tension_gives_that_tension_while_winding_in(tension):
    model = TorqueModel(0.354, 0.05)
    force, stddev = model.pull(model.current(tension, 0.010), 0.02, 0.010)
    assert force == pytest.approx(tension)
    assert stddev > 0.15 * tension


def test_friction_makes_the_same_current_mean_more_tension_while_paying_out():
    model = TorqueModel(0.354, 0.05)
    gap = model.pull(0.3, -0.02, 0.010)[0] - model.pull(0.3, 0.02, 0.010)[0]
    assert gap == pytest.approx(2 * 0.05 * 0.354 / 0.010)


def test_a_standing_drive_is_less_certain_than_a_moving_one():
    model = TorqueModel(0.354, 0.05)
    assert model.pull(0.1, 0.0, 0.010)[1] > model.pull(0.1, 0.02, 0.010)[1]


def test_calibration_recovers_the_constants_it_was_made_from():
    rng = np.random.default_rng(5)
    k, friction, radius = 0.31, 0.06, 0.010
    tensions = rng.uniform(1.0, 25.0, 200)
    direction = rng.choice([-1.0, 1.0], 200)
    currents = tensions * radius / k + friction * direction + rng.normal(0.0, 0.002, 200)
    model = fit_torque_model(currents, 0.01 * direction, tensions, radius, "load cell")
    assert model.torque_per_ampere == pytest.approx(k, rel=0.01)
    assert model.friction_current == pytest.approx(friction, abs=0.003)
    assert model.relative_stddev < 0.02


def test_a_quick_round_counts_by_its_way_not_by_its_few_samples():
    """Gears rub less the faster they turn: friction is the mean over the way, 160 parts at 2 and 192 at 24 mm/s."""
    k, radius, lifted = 0.386, 0.010, np.linspace(1.0, 24.0, 8)
    speed = np.repeat((0.002, -0.002, 0.024, -0.024), (80, 80, 8, 8))
    tension = np.concatenate([np.tile(lifted, 10), np.tile(lifted, 10), lifted, lifted])
    friction = np.where(np.abs(speed) < 0.01, 0.08, 0.04)
    currents = tension * radius / k + np.sign(speed) * friction
    model = fit_torque_model(currents, speed, tension, radius, "weights")
    assert model.friction_current == pytest.approx((160 * 0.08 + 192 * 0.04) / 352, rel=0.03)
    assert model.torque_per_ampere == pytest.approx(k, rel=0.03)


@pytest.mark.parametrize("growth", [0.0, 1500.0])
def test_what_a_model_leaves_over_when_quick_widens_what_it_states_when_quick(growth):
    """Readings scatter by 0.2 N at rest, and by growth v^2 beside; 24 mm/s make 0.86 N of it."""
    rng = np.random.default_rng(8)
    k, friction, radius, samples = 0.386, 0.06, 0.010, 4000
    speed = rng.choice((0.002, 0.006, 0.024), samples) * rng.choice((-1.0, 1.0), samples)
    tension = rng.uniform(1.0, 24.0, samples)
    scatter = rng.normal(0.0, np.hypot(0.2, growth * speed**2))
    model = fit_torque_model((tension + scatter) * radius / k + np.sign(speed) * friction, speed, tension, radius, "x")
    assert model.quick_stddev == pytest.approx(growth, rel=0.1, abs=150.0)
    for at_m_s in (0.002, 0.024):
        rest = replace(model, quick_stddev=0.0).pull(0.3, at_m_s, radius)[1]
        widened = model.pull(0.3, at_m_s, radius)[1]
        assert widened == pytest.approx(np.hypot(rest, model.quick_stddev * at_m_s**2))
    at_one_speed = fit_torque_model(tension * radius / k + scatter, np.sign(speed) * 0.006, tension, radius, "x")
    assert at_one_speed.quick_stddev == 0.0


def test_calibration_says_what_is_missing():
    with pytest.raises(ConfigurationError, match="paying out"):
        fit_torque_model([0.1] * 10, [0.01] * 10, [3.0] * 10, 0.01, "x")
    with pytest.raises(ConfigurationError, match="direction sign"):
        fit_torque_model(-np.linspace(0.1, 1.0, 10), [0.01, -0.01] * 5, np.linspace(1.0, 20.0, 10), 0.01, "x")
