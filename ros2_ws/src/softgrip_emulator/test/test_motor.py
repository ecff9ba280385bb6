# SPDX-License-Identifier: Apache-2.0
"""Motor and supply against the ratings of the data sheets and first-order heat."""

import math

import pytest

from softgrip_emulator.dynamixel.motion import ServoDrive
from softgrip_emulator.dynamixel.servo import Shaft
from softgrip_emulator.dynamixel.table import available_models, load_model
from softgrip_emulator.plant.motor import AMBIENT_C, Motor

# e-manual: stall torque [N m] and current [A], no-load speed [rpm], at nominal voltage [V]
RATINGS = {
    "xl330_m288": (0.52, 1.47, 103, 5.0),
    "xc330_m288": (0.93, 1.80, 81, 5.0),
    "xc330_t288": (0.92, 0.80, 65, 11.1),
    "xm430_w210": (3.0, 2.3, 77, 12.0),
    "xm430_w350": (4.1, 2.3, 46, 12.0),
    "xm540_w150": (7.3, 4.4, 53, 12.0),
    "xm540_w270": (10.6, 4.4, 30, 12.0),
    "xl430_w250": (1.4, 1.3, 57, 11.1),
    "xc430_w150": (1.6, 1.4, 106, 12.0),
    "xc430_w240": (1.9, 1.4, 70, 12.0),
}


@pytest.fixture(params=available_models())
def rated(request):
    motor = Motor(load_model(request.param).motor, Shaft(), spool_radius_m=0.010)
    return motor, *RATINGS[request.param]


def run(motor, drive, tension_n, voltage_v, seconds, dt_s=1e-3):
    for _ in range(round(seconds / dt_s)):
        motor.step(drive, tension_n, voltage_v, dt_s)


def test_no_load_speed(rated):
    motor, _, _, rpm, voltage_v = rated
    run(motor, ServoDrive(1.0, 10.0), 0.0, voltage_v, 1.0)
    assert motor.shaft.velocity_rad_s * 60 / (2 * math.pi) == pytest.approx(rpm, rel=0.02)


def test_stall_current_and_the_tension_it_can_just_not_pull(rated):
    motor, torque_nm, current_a, _, voltage_v = rated
    # The tendon presses the gear's teeth: 6 % of the load is lost besides.
    can_pull_n = torque_nm / motor.spool_radius_m / 1.06
    run(motor, ServoDrive(1.0, 10.0), 1.02 * can_pull_n, voltage_v, 0.3)
    assert motor.shaft.velocity_rad_s == 0.0
    assert motor.shaft.current_a == pytest.approx(current_a, rel=0.02)
    run(motor, ServoDrive(1.0, 10.0), 0.9 * can_pull_n, voltage_v, 0.3)
    assert motor.shaft.velocity_rad_s > 0.0


def test_the_current_limit_bounds_the_pull(rated):
    motor, torque_nm, current_a, _, voltage_v = rated
    run(motor, ServoDrive(1.0, 0.5 * current_a), 0.6 * torque_nm / 0.010, voltage_v, 0.3)
    assert motor.shaft.velocity_rad_s <= 0.0
    assert motor.shaft.current_a <= 0.5 * current_a + 1e-9


def test_friction_holds_a_small_load_without_current(rated):
    motor = rated[0]
    run(motor, ServoDrive(), 0.8 * motor.ratings.gear_friction_nm / 0.010, 5.0, 0.5)
    assert motor.shaft.angle_rad == 0.0
    run(motor, ServoDrive(), 3.0 * motor.ratings.gear_friction_nm / 0.010, 5.0, 0.5)
    assert motor.shaft.angle_rad < 0.0


@pytest.mark.parametrize("speed", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_limit_of_the_supply_acts_on_power(rated, speed, sign):
    """By the balance of power: V i_supply = R i^2 + e i; at stall the pull grows with the root of the limit only."""
    motor, _, current_a, _, voltage_v = rated
    ratings, shaft = motor.ratings, motor.shaft
    limit_a = 0.05 * current_a
    shaft.velocity_rad_s = sign * speed
    motor.step(ServoDrive(sign, limit_a, limits_supply=True), 0.0, voltage_v, 1e-6)
    emf_v = ratings.back_emf_vs_per_rad * speed
    current = sign * shaft.current_a
    ohm = ratings.resistance_ohm
    assert (ohm * current + emf_v) * current / voltage_v == pytest.approx(limit_a, rel=1e-3)
    assert shaft.supply_current_a == pytest.approx(sign * limit_a, rel=1e-3)
    assert shaft.duty == pytest.approx(sign * (ohm * current + emf_v) / voltage_v, rel=1e-3)


def test_a_limit_of_the_winding_acts_on_its_current(rated):
    motor, _, current_a, _, voltage_v = rated
    motor.shaft.velocity_rad_s = 1.0
    motor.step(ServoDrive(1.0, 0.05 * current_a), 0.0, voltage_v, 1e-6)
    assert motor.shaft.current_a == pytest.approx(0.05 * current_a)
    # What the power stage shows is the duty cycle that it is left with.
    applied_v = motor.ratings.resistance_ohm * motor.shaft.current_a + motor.ratings.back_emf_vs_per_rad
    assert motor.shaft.duty == pytest.approx(applied_v / voltage_v, rel=1e-3)


def test_a_warm_winding_resists_as_copper_does(rated):
    motor, _, current_a, _, voltage_v = rated
    motor.jammed = True
    motor.step(ServoDrive(1.0, 10.0), 0.0, voltage_v, 1e-3)
    cold_a = motor.shaft.current_a
    motor.shaft.winding_c += 50.0
    motor.step(ServoDrive(1.0, 10.0), 0.0, voltage_v, 1e-3)
    # IEC 60028: copper at 75 degC has 1.1966 times its resistance at 25.
    assert cold_a / motor.shaft.current_a == pytest.approx(1.1966, abs=2e-3)
    assert cold_a == pytest.approx(current_a, rel=0.01)


def test_the_winding_is_warmer_than_the_sensor_by_what_it_gives_off(rated):
    motor = rated[0]
    ratings = motor.ratings
    motor.jammed = True
    third_a = 0.3 * ratings.stall_current_a
    run(motor, ServoDrive(1.0, third_a), 0.0, ratings.nominal_voltage_v, 120.0, dt_s=0.02)
    copper_w = third_a**2 * motor.resistance_ohm(motor.shaft.winding_c)
    gap_k = motor.shaft.winding_c - motor.shaft.temperature_c
    assert gap_k == pytest.approx(copper_w * ratings.winding_to_case_k_per_w, rel=0.1)


def test_heat_follows_the_first_order_law(rated):
    motor = rated[0]
    ratings = motor.ratings
    motor.shaft.temperature_c = motor.shaft.winding_c = AMBIENT_C
    motor.extra_heat_w = 2.0
    span_s = ratings.heat_capacity_j_per_k * ratings.thermal_resistance_k_per_w
    run(motor, ServoDrive(), 0.0, 5.0, span_s, dt_s=0.05)
    rise = 2.0 * ratings.thermal_resistance_k_per_w * (1.0 - math.exp(-1.0))
    assert motor.shaft.temperature_c - AMBIENT_C == pytest.approx(rise, rel=0.01)
