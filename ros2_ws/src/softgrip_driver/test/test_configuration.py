# SPDX-License-Identifier: Apache-2.0
"""Values that contradict each other are refused with what was expected, what was found, before a port is opened."""

import pytest

from softgrip_driver.configuration import checked_configuration
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.tendon.units import Spool

#: what an XM430-W350 needs
GENTLE = {"homing_tension_n": 5.0, "speed_m_s": 0.03, "acceleration_m_s2": 0.05, "loop_rate": 200.0}


def configured(**changes):
    """A configuration from the table of parameters as shipped."""
    return checked_configuration({row.name: row.default for row in PARAMETERS.rows} | changes)


def test_one_value_counts_for_every_tendon():
    found = configured(spool_radii_m=[0.010, 0.012, 0.010], directions=[-1], servo_models=["XM430-W350"], **GENTLE)
    assert found.spools == {"index": Spool(0.010, -1), "middle": Spool(0.012, -1), "thumb": Spool(0.010, -1)}
    assert [servo.model.name for servo in found.drives.servos] == ["XM430-W350"] * 3
    assert [servo.servo_id for servo in found.drives.servos] == [1, 2, 3]


def test_a_measured_torque_model_replaces_the_data_sheet_s_for_its_own_tendon():
    found = configured(torque_per_ampere_nm_a=[0.0, 0.31, 0.0], friction_currents_a=[0.0, 0.04, 0.0])
    first, second, _ = (servo.torque for servo in found.drives.servos)
    assert (first.source, second.source) == ("data sheet", "calibrated")
    assert (second.torque_per_ampere, second.friction_current) == (0.31, 0.04)
    assert first.torque_per_ampere == pytest.approx(0.52 / 1.47)


STAGE = {"backend": "grbl", "tendons": ["pull"], "loop_rate": 10.0, "gauge_port": "/dev/ttyUSB1"}


def test_a_stage_takes_one_tendon_and_a_gauge():
    assert configured(**STAGE).drives.gauge.kind == "gcl2"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"tendons": ["index", "index", "thumb"]}, "expected names that differ"),
        ({"tendons": []}, "expected names that differ"),
        ({"baud": 12345}, "expected one of"),
        ({"servo_ids": [1, 2, 2]}, r"expected each ID once, found \[1, 2, 2\]"),
        ({"servo_ids": [1, 2]}, "expected one value, or one for each of"),
        ({"servo_models": ["XL320"]}, "expected names out of .*found 'XL320'"),
        ({"spool_radii_m": [0.0]}, "expected a radius between"),
        ({"tension_hard_n": 30.0}, "expected tension_slack <= homing_tension <= tension_soft <= tension_hard"),
        ({"homing_tension_n": 40.0}, "expected tension_slack <= homing_tension <= tension_soft <= tension_hard"),
        ({"speed_m_s": 0.0}, "expected a number above 0"),
        (
            GENTLE | {"servo_models": ["XM430-W350", "XL330-M288", "XM430-W350"], "temperature_limit_degc": 80.0},
            "temperature_limit_degc: expected at most the 70 degC .*found 80",
        ),
        # 0.7 of 0.52 N m on 10 mm.
        ({"tension_soft_n": 37.0}, r"tension_soft_n: expected at most 36\.4 N"),
        ({"spool_radii_m": [0.012]}, r"tension_soft_n: expected at most 30\.3 N"),
        ({"loop_rate": 20.0}, "bus_watchdog_s: expected 0, or at least 2 periods"),
        (STAGE | {"tendons": ["a", "b"]}, "expected one with backend 'grbl'"),
        (STAGE | {"gauge_port": ""}, "without one nobody knows the tension"),
        (STAGE | {"loop_rate": 100.0}, "expected at most 10 Hz"),
    ],
)
def test_what_contradicts_itself_is_refused(changes, text):
    with pytest.raises(ConfigurationError, match=text):
        configured(**changes)


def test_a_slow_loop_takes_a_slow_watchdog_or_none():
    assert configured(loop_rate=20.0, bus_watchdog_s=0.1).drives.bus_watchdog == 0.1
    assert configured(loop_rate=20.0, bus_watchdog_s=0.0).drives.bus_watchdog == 0.0


def test_the_strongest_servo_may_get_as_warm_as_it_can_stand():
    assert configured(servo_models=["XM430-W350"], temperature_limit_degc=80.0, **GENTLE).drives.servos


def test_limits_that_a_model_can_not_keep_are_refused_with_the_values_that_it_can():
    """What failed: homing on two of three tendons, and a false slack at the speed that an XL330 takes."""
    minima = (
        r"XM430-W350 on a spool of 10 mm: .*homing_tension_n of at least 5 N, found 1.5; loop_rate of at least 200 Hz"
    )
    maxima = r".*speed_m_s of at most 0.03 m/s, found 0.05; acceleration_m_s2 of at most 0.05"
    with pytest.raises(ConfigurationError, match=minima + maxima):
        configured(servo_models=["XM430-W350"])
    with pytest.raises(ConfigurationError, match=r"speed_m_s of at most 0.03 m/s, found 0.05"):
        configured(servo_models=["XC330-M288"])
    # On a spool twice as wide the same shaft moves the tendon twice as fast, with half the force.
    wide = configured(servo_models=["XM430-W350"], spool_radii_m=[0.020], homing_tension_n=2.5, speed_m_s=0.06,
                      acceleration_m_s2=0.1, loop_rate=200.0)  # fmt: skip
    assert [servo.model.name for servo in wide.drives.servos] == ["XM430-W350"] * 3
