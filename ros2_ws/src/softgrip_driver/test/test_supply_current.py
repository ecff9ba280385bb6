# SPDX-License-Identifier: Apache-2.0
"""Servos that sense the current of their supply: the winding's from the duty cycle, limits by the balance of power."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.commands import calibrate_tension
from softgrip_driver.configuration import checked_configuration
from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, OperatingMode
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.tendon.gripper import MoveMode
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.needs import fitted_limits
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.tendon.winding import MotorReading, Winding, WindingWarmth, fit_winding

WINDING = Winding(3.4, 0.44, 0.05)
SUPPLY, PHASE = CurrentSensing.SUPPLY, CurrentSensing.WINDING


def seen(duty=0.0, speed=0.0, voltage=5.0, temperature=25.0, current=0.0):
    return MotorReading(current, duty, speed, voltage, temperature)


def servo_of(limits=None, model="XL330-M288"):
    table = MODELS[model]
    torque = TorqueModel(table.torque_per_ampere, table.no_load_current)
    return ServoConfiguration("t", 1, table, Spool(0.010, 1), torque, limits=limits)


@given(st.floats(0.02, 1.4), st.floats(0.0, 5.0), st.floats(3.7, 6.0))
def test_what_the_power_stage_takes_in_comes_out_as_heat_and_work(current, speed, voltage):
    """Conservation of energy: V i_supply is the copper's heat and the back-EMF's power."""
    supply = WINDING.supply_current(current, speed, voltage, 25.0)
    assert voltage * supply == pytest.approx(3.4 * current**2 + 0.44 * speed * current)
    duty = (3.4 * current + 0.44 * speed) / voltage
    assert supply == pytest.approx(duty * current)
    assert WINDING.current(seen(duty, speed, voltage))[0] == pytest.approx(current)


def test_a_warm_winding_resists_more_and_a_stage_that_is_off_carries_nothing():
    # IEC 60028: 1.1965 times the resistance of 25 degC at 75
    assert WINDING.resistance_at(75.0) == pytest.approx(3.4 * 1.1965)
    assert WINDING.current(seen(0.0, speed=2.0)) == (0.0, 0.0)


def test_the_stated_deviation_covers_ten_kelvin_of_copper_and_a_count_of_the_voltage():
    known = replace(WINDING, relative_stddev=0.0)
    current, stddev = known.current(seen(0.5))
    assert stddev == pytest.approx(math.hypot(0.0393 * current, 0.5 * 0.05 / 3.4), rel=0.02)
    assert WINDING.current(seen(0.5))[1] > stddev


def test_a_winding_is_fitted_from_the_supply_s_current():
    rng = np.random.default_rng(7)
    readings = []
    for _ in range(200):
        speed, voltage = rng.choice([-0.9, -0.3, 0.3, 0.9]), rng.uniform(4.5, 5.2)
        duty = (3.1 * rng.uniform(0.05, 0.7) + 0.40 * speed) / voltage
        current = duty * (duty * voltage - 0.40 * speed) / 3.1
        readings.append(seen(duty, speed, voltage, current=round(current, 3)))
    found = fit_winding(readings, WINDING)
    assert found.resistance == pytest.approx(3.1, rel=0.01)
    assert found.back_emf == pytest.approx(0.40, rel=0.03)
    assert 0.0 < found.relative_stddev < 0.02
    with pytest.raises(ConfigurationError, match="at least 20"):
        fit_winding(readings[:5], WINDING)
    with pytest.raises(ConfigurationError, match=r"higher tension|grows with the duty"):
        fit_winding([seen(0.05, 0.3, 5.0, current=rng.normal(0.0, 0.01)) for _ in range(30)], WINDING)


def warm_reading(tension_current, above_k, speed=0.0):
    """What a servo shows whose winding is warmer than its sensor (30 degC); resistance of copper by IEC 60028."""
    ohm = 3.4 * (1.0 + 0.00393 * (30.0 + above_k - 25.0))
    duty = (ohm * tension_current + 0.44 * speed) / 5.0
    return seen(duty, speed, 5.0, 30.0, current=duty * tension_current)


def watched(reading, seconds=4.0, warmth=None, start=0.0):
    warmth = warmth or WindingWarmth()
    for step in range(round(seconds * 100)):
        warmth.observe(CALIBRATED, reading, start + step * 0.01)
    return warmth


CALIBRATED = replace(WINDING, relative_stddev=0.01)


@pytest.mark.parametrize("above_k", [0.0, 25.0, 50.0])
@pytest.mark.parametrize("speed", [-1.0, 0.0, 1.0])
def test_a_strong_pull_shows_how_warm_the_winding_is(above_k, speed):
    """20 N on an XL330: 0.6 A. Without it the current would be off by a tenth for 25 K."""
    reading = warm_reading(0.6, above_k, speed)
    warmth = watched(reading)
    assert warmth.above_sensor_k == pytest.approx(above_k, abs=0.3 * above_k + 1.0)
    assert abs(warmth.above_sensor_k - above_k) < 3.0 * warmth.stddev_k
    current, stddev = CALIBRATED.current(reading, warmth)
    unaware, more = CALIBRATED.current(reading)
    assert abs(current - 0.6) <= 0.3 * abs(unaware - 0.6) + 1e-9
    assert stddev < more


def test_a_small_pull_shows_little_and_says_so():
    warmth = watched(warm_reading(0.06, 25.0))
    assert warmth.above_sensor_k < 10.0
    assert warmth.stddev_k > 7.0


def test_what_was_seen_of_the_warmth_is_forgotten_when_nothing_shows_it():
    warmth = watched(warm_reading(0.6, 40.0))
    known = warmth.above_sensor_k
    watched(seen(temperature=30.0), 60.0, warmth, 4.0)
    assert warmth.above_sensor_k < 0.06 * known
    assert warmth.stddev_k == pytest.approx(10.0, abs=0.1)


def test_a_motor_whose_duty_changes_shows_no_warmth():
    """A current that is filtered in the servo lags behind its duty cycle meanwhile."""
    warmth = WindingWarmth()
    for step in range(100):
        duty = 0.1 * 1.2 ** (step % 10)
        warmth.observe(CALIBRATED, seen(duty, current=0.5 * duty), step * 0.01)
    assert warmth.above_sensor_k == 0.0


def test_a_resistance_of_no_working_motor_is_believed_up_to_a_bound():
    """1.9 times the resistance would be copper at 254 degC: the sensor's zero, or a bad contact."""
    assert watched(seen(0.9, current=0.9 * 4.5 / (1.9 * 3.4)), 60.0).above_sensor_k == 80.0
    assert watched(seen(0.9, current=0.9 * 4.5 / (2.1 * 3.4)), 60.0).above_sensor_k == 0.0


@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-9.0, 9.0), st.floats(-2.0, 2.0)), min_size=2, max_size=40))
def test_no_reading_makes_the_warmth_absurd(readings):
    warmth = WindingWarmth()
    for step, (duty, speed, current) in enumerate(readings):
        warmth.observe(CALIBRATED, seen(duty, speed, current=current), step * 0.5)
        assert -10.0 <= warmth.above_sensor_k <= 80.0
        assert 0.0 < warmth.stddev_k <= 10.0 + 1e-9


def test_an_uncalibrated_servo_does_not_judge_its_warmth():
    """A tenth by which its resistance is off the data sheet's would pass for 25 K."""
    assert not servo_of().shows_warmth
    assert replace(servo_of(), winding=CALIBRATED).shows_warmth
    assert not replace(servo_of(model="XM430-W350"), winding=CALIBRATED).shows_warmth


def test_a_limit_of_the_supply_is_less_than_that_of_the_winding_and_grows_with_speed():
    """By hand: 10 N on 10 mm and 50 mA of friction are 0.3327 A in the winding, and 75.3 mA of 5 V at stall."""
    assert servo_of(PHASE).current_units(10.0) == 333
    assert servo_of(SUPPLY).current_units(10.0) == servo_of().current_units(10.0) == 75
    back_emf = MODELS["XL330-M288"].back_emf
    assert servo_of().current_units(10.0, seen(speed=2.0)) == round(75.3 + 332.7 * back_emf * 2.0 / 5.0)
    # Paying out, or faster than the servo's own profile lets it turn, adds nothing.
    assert servo_of().current_units(10.0, seen(speed=-2.0)) == 75
    assert servo_of().current_units(10.0, seen(speed=50.0)) == servo_of().current_units(10.0, seen(speed=5.0))
    # A reading of no voltage at all must not let through everything.
    assert servo_of().current_units(10.0, seen(voltage=0.0)) == round(75.3 * 5.0 / 3.7)


def test_a_servo_without_current_is_limited_by_the_duty_cycle_that_makes_it():
    """By hand, XL430 on 10 mm: 10 N and 50 mA of friction are 0.1429 A, 1.22 V of 11.1 on 8.54 ohm; k_e 1.788 V s."""
    servo = replace(servo_of(model="XL430-W250"), mode=OperatingMode.EXTENDED_POSITION)
    assert servo.limit_item is reg.GOAL_PWM
    standing = seen(voltage=11.1)
    assert servo.limit_units(10.0, standing) == servo.duty_units(10.0) == round(885 * 1.2198 / 11.1)
    for speed in (2.0, -2.0):  # it bounds both directions, so paying out needs room, too
        moving = servo.duty_units(10.0, replace(standing, speed=speed))
        assert moving == pytest.approx(885 * (1.2198 + 2.0 * 1.7882) / 11.1, abs=1.0)
    # Faster than the servo's own profile lets it turn adds nothing; a reading of no voltage must not let through all.
    assert servo.duty_units(10.0, replace(standing, speed=50.0)) == servo.duty_units(10.0, replace(standing, speed=5.0))
    assert servo.duty_units(10.0, seen(voltage=0.0)) == round(885 * 1.2198 / 6.5)
    assert servo.duty_units(1e4, standing) == 885
    assert replace(servo_of(), mode=OperatingMode.EXTENDED_POSITION).limit_item is None
    assert servo_of().limit_item is reg.GOAL_CURRENT


def without_current():
    limits = fitted_limits(TendonLimits(no_reply=0.05), MODELS["XL430-W250"], 0.010)
    return {"model": "XL430-W250", "mode": OperatingMode.EXTENDED_POSITION, "limits": limits}


@pytest.mark.parametrize("bench", [without_current()], indirect=True, ids=["XL430"])
def test_a_lost_duty_limit_is_written_again_and_the_mark_of_the_zero_stands_elsewhere(bench):
    bench.hold_taut(0.0)
    registers = bench.plant.servos[0].registers
    assert registers.get("goal_velocity") == 1  # the mark that hold_taut has set
    with bench.plant.lock:
        registers.put("goal_pwm", 885)
    written, send = [], bench.backend.bus.sync_write
    bench.backend.bus.sync_write = lambda item, values: (written.extend([item] * bool(values)), send(item, values))
    cycles = bench.pass_time(0.2)
    assert registers.get("goal_pwm") < 400
    assert written.count(reg.GOAL_PWM) >= len(cycles) - 1
    bench.cause("silent_reboot", slot="index")
    assert bench.until(lambda seen: seen.drives[0].fault == "rebooted", 2.0), bench.drive("index")
    assert not bench.drive("index").homed


def test_an_xm430_goes_on_by_the_winding_s_own_current():
    servo = servo_of(model="XM430-W350")
    assert not servo.limits_supply
    assert servo.pull(seen(0.9, 0.0, 12.0, current=0.5))[0] == 0.5


def test_a_tension_estimate_follows_the_duty_cycle_and_not_the_current_that_is_read():
    """0.14 of 5 V on 3.4 ohm, standing: 0.2 A, 7.3 N; the supply gives 29 mA meanwhile, which would be 1 N."""
    current, pull, stddev = servo_of().pull(seen(0.1388, current=0.029))
    assert current == pytest.approx(0.204, abs=0.002)
    assert pull == pytest.approx(7.2, abs=0.1)
    assert 1.0 < stddev < 2.0


@pytest.fixture
def values():
    return {row.name: row.default for row in PARAMETERS.rows}


def test_calibrated_values_and_the_limited_current_reach_the_servo(values):
    values |= {"winding_resistances_ohm": [3.1], "back_emfs_v_s": [0.41], "limited_currents": ["winding"]}
    values |= {"torque_per_ampere_nm_a": [0.33], "friction_slopes_a_s_m": [0.5], "gear_load_shares": [0.06]}
    values |= {"quick_stddevs_n_s2_m2": [800.0]}
    servo = checked_configuration(values).drives.servos[0]
    assert (servo.motor.resistance, servo.motor.back_emf) == (3.1, 0.41)
    assert (servo.torque.friction_slope, servo.torque.load_share, servo.torque.quick_stddev) == (0.5, 0.06, 800.0)
    assert not servo.limits_supply
    with pytest.raises(ConfigurationError, match="expected both of a calibration"):
        checked_configuration(values | {"back_emfs_v_s": [0.0]})


def test_a_servo_without_current_is_refused_in_the_mode_that_needs_one(values):
    values |= {"servo_models": ["XL430-W250"], "temperature_limit_degc": 70.0, "homing_tension_n": 3.0}
    values |= {"speed_m_s": 0.03, "acceleration_m_s2": 0.1, "loop_rate": 200.0}
    with pytest.raises(ConfigurationError, match="expected 4 with a XL430-W250"):
        checked_configuration(values)
    servo = checked_configuration(values | {"operating_mode": 4}).drives.servos[0]
    assert not servo.has_current_limit
    assert servo.pull(seen(0.1, 0.0, 11.1))[1] > 0.0


BENCHES = [{"limits_current": SUPPLY}, {"limits_current": PHASE}]


@pytest.mark.parametrize("bench", BENCHES, indirect=True, ids=["supply", "winding"])
def test_homing_tensions_and_closings_whichever_current_the_servo_limits(bench):
    """True tensions of the plant; the data sheet alone, so within what the driver itself states."""
    highest = np.zeros(3)
    bench.world.live(lambda _: np.maximum(highest, bench.plant.bank.tension_n, out=highest))
    bench.loop.power(on=True)
    assert bench.run(bench.loop.call(lambda c, now: c.home(now)), 20.0)[0] is MoveOutcome.REACHED
    # 1.5 N are asked for; the friction of the gears, assumed as 50 mA, may be worth 1.8 N.
    assert highest.max() < 3.5
    taut = bench.plant.wound_m() - bench.plant.bank.slack_m
    lengths = [drive.pulled_length_m for drive in bench.loop.snapshot.drives]
    assert lengths == pytest.approx(taut, abs=4e-4)
    # A new cable beds in by a quarter of a millimetre, worth all of 2 N (docs/emulator.md): pulled once first.
    bench.run(bench.move([20.0], 0.02, mode=MoveMode.TENSION))
    bench.pass_time(2.0)
    bench.run(bench.move([0.0], 0.02))
    for asked in (2.0, 5.0, 10.0, 20.0):
        assert bench.run(bench.move([asked], 0.02, mode=MoveMode.TENSION))[0] is MoveOutcome.REACHED
        bench.pass_time(0.3)
        true = bench.plant.bank.tension_n
        stated = [drive.tension_stddev for drive in bench.loop.snapshot.drives]
        # Beside what the driver states, a soft finger relaxes by up to 8 % in this time.
        assert np.all(np.abs(true - asked) < np.maximum(0.05 * asked, 1.3) + 0.7)
        estimated = [drive.tension for drive in bench.loop.snapshot.drives]
        assert np.all(np.abs(true - estimated) < 2.0 * np.array(stated))
    bench.run(bench.move([0.0], 0.02))
    outcome, reason = bench.run(bench.move([0.015], 0.05))
    assert outcome is MoveOutcome.REACHED, reason


@pytest.mark.parametrize("bench", BENCHES, indirect=True, ids=["supply", "winding"])
def test_which_current_a_servo_limits_is_found_out_with_the_smaller_pull(bench):
    bench.loop.stop()
    bench.backend._live = {"index": bench.backend._live["index"]}
    servo = bench.backend._live["index"].servo
    bench.backend._live["index"].servo = replace(servo, limits=None)
    highest = [0.0]
    bench.world.live(lambda _: highest.append(max(highest[-1], float(bench.plant.bank.tension_n[0]))))
    assert calibrate_tension.find_limited_current(bench.backend, 6.0) is servo.limits
    # 6 N, what its gears are thought to need, and what its own momentum is worth
    assert highest[-1] < 9.0
    assert bench.plant.servos[0].registers.get("torque_enable") == 0


def test_a_limit_for_a_motor_that_turns_ends_with_its_answers(bench):
    """Where the servo falls silent nobody knows whether it still turns: the limit is the one of a servo that stands."""
    bench.hold_taut(0.0)
    bench.move([0.02], 0.03)
    assert bench.until(lambda snap: snap.drives[0].speed > 0.02, 2.0)
    assert bench.backend.motor("index").speed > 1.5
    bench.cause("servo_silent", slot="index")
    bench.pass_time(0.02)
    assert bench.backend.motor("index").speed == 0.0
