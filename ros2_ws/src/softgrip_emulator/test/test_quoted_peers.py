# SPDX-License-Identifier: Apache-2.0
"""Facts of the emulated devices beside what other people's programs and measurements say, quoted with their places."""

import math
from pathlib import Path

import pytest
import yaml

from softgrip_emulator import damiao
from softgrip_emulator.dynamixel.motion import ServoDrive
from softgrip_emulator.dynamixel.servo import Shaft
from softgrip_emulator.dynamixel.table import available_models, load_model
from softgrip_emulator.feetech.servo import DUTY_PER_RAD
from softgrip_emulator.plant.motor import Motor
from softgrip_emulator.rig.amplifier import counts_of
from softgrip_emulator.rig.polled import EmulatedPolledGauge
from softgrip_emulator.rig.sketches import EmulatedBoard
from softgrip_emulator.servos import load_ratings

X330 = [name for name in available_models() if "330" in name]


def still(name, drive, supply_v=5.0):
    """A jammed motor after a moment with a duty cycle and a limit."""
    motor = Motor(load_model(name).motor, Shaft(), spool_radius_m=0.010)
    motor.jammed = True
    motor.step(drive, 0.0, supply_v, 1e-3)
    return motor


@pytest.mark.parametrize("name", X330)
@pytest.mark.parametrize("limit_a", [0.02, 0.1, 0.3])
def test_a_supply_limit_gives_the_duty_of_rhoban_s_model(name, limit_a):
    """Rhoban/bam 1b5a1ce, bam/dynamixel/actuator.py: the root of vin duty^2 - kt dq duty - R |I_bus| = 0.

    Its authors call it untested, but measured that an XL330 reports the bus current (issue 14: "for sure").
    """
    motor = still(name, ServoDrive(1.0, limit_a, limits_supply=True))
    resistance = motor.resistance_ohm(motor.shaft.winding_c)
    duty = math.sqrt(4.0 * 5.0 * resistance * limit_a) / (2.0 * 5.0)
    assert motor.shaft.duty == pytest.approx(min(1.0, duty), rel=1e-3)


@pytest.mark.parametrize("alpha", [3.920e-3, 0.00393])
def test_copper_resists_as_in_other_people_s_machines(alpha):
    """Modelica.Electrical.Machines.Thermal.Constants.alpha20Copper; FAST-OAD_CS23-HE, COPPER_TEMPERATURE_COEFF."""
    motor = Motor(load_model("xl330_m288").motor, Shaft(), spool_radius_m=0.010)
    # Theirs counts from 20 degC, the data sheet's resistance here belongs to 25.
    expected = (1.0 + alpha * 65.0) / (1.0 + alpha * 5.0)
    assert motor.resistance_ohm(85.0) / motor.resistance_ohm(25.0) == pytest.approx(expected, rel=5e-3)


def test_the_xc330_t288_is_as_far_from_robotis_table_as_docs_say():
    """dynamixel_hardware_interface 4343a04, param/dxl_model/xc330_t288.model: Present Current in N m a milliampere."""
    robotis = 0.0009674796739867748 / load_model("xc330_t288").motor.current_unit_a
    sheet = load_model("xc330_t288").motor
    assert 1.0 - robotis / (sheet.stall_torque_nm / sheet.stall_current_a) == pytest.approx(0.16, abs=0.005)


def test_damiao_s_ranges_are_those_of_lerobot():
    """huggingface/lerobot 7427f31, motors/damiao/tables.py, MOTOR_LIMIT_PARAMS[DM4310]: position, speed, torque."""
    table = yaml.safe_load((Path(damiao.__file__).parent / "dm_j4310_2ec.yaml").read_text(encoding="utf-8"))
    registers = {row[0]: row[3] for row in table["registers"].values()}
    assert (registers["pmax"], registers["vmax"], registers["tmax"]) == (12.5, 30.0, 10.0)


def test_an_sts3215_turns_and_pulls_as_its_users_say():
    """matthieuvigne/STS_servos, README: "Stall torque 19kg.cm", "Running speed 50rpm @ 7V"."""
    ratings = load_ratings("STS3215")
    assert ratings.stall_torque_nm == pytest.approx(19.0 * 0.0980665, rel=0.01)
    assert ratings.no_load_speed_rpm * 7.0 / ratings.nominal_voltage_v == pytest.approx(50.0, rel=0.05)


@pytest.mark.parametrize("duty_per_rad", [0.166, 0.16489])
def test_an_sts3215_turns_an_error_into_a_duty_as_others_measured(duty_per_rad):
    """Rhoban/bam 1b5a1ce, feetech/actuator.py, error_gain (oscilloscope); kscalelabs/sysid, error_gain of its fits."""
    assert pytest.approx(duty_per_rad, rel=0.02) == DUTY_PER_RAD


def test_an_sts3215_rubs_as_rhoban_found_and_is_lighter():
    """Rhoban/bam 1b5a1ce, params/feetech_sts3215_7_4V/m1.json: friction_base [N m], friction_viscous, armature.

    Its inertia is three times the assumed one, its viscous friction five times: docs/emulator.md says so.
    """
    ratings = load_ratings("STS3215")
    assert ratings.gear_friction_nm == pytest.approx(0.0524, rel=0.15)
    assert 0.02840 / ratings.inertia_kgm2 == pytest.approx(2.9, abs=0.1)
    assert 0.0591 / ratings.gear_viscous_nms == pytest.approx(5.5, abs=0.1)


class Cell:
    """A load cell that reads what it is given [N]."""

    def __init__(self, force):
        self.force = force

    def read(self, _now_s):
        return self.force


@pytest.mark.parametrize("force", [0.0, 0.981, -0.5, 49.05])
def test_a_balance_answers_as_pylabrobot_reads_it(force):
    """PyLabRobot 2dfdc0d6, scales/mettler_toledo/protocol.md, of a WXS205SDU: 9600 baud, "<CMD> <Status> data unit".

    The answer to SI is headed S; status D is a weight that moves.
    """
    (answer,) = EmulatedPolledGauge(Cell(force), "mt_sics").exchange(b"SI\r\n", 0.0, 9600)
    command, status, weight, unit = answer.data.removesuffix(b"\r\n").split()
    assert (command, unit) == (b"S", b"g")
    assert status in {b"S", b"D"}
    assert float(weight) == pytest.approx(1e3 * force / 9.81, abs=0.005)


@pytest.mark.parametrize(
    ("force", "command", "expected"), [(math.inf, b"SI\r\n", b"S +\r\n"), (1.0, b"XX\r\n", b"ES\r\n")]
)
def test_a_balance_that_can_not_answer_says_so_as_pylabrobot_reads_it(force, command, expected):
    """The same page: status "+" is overload, "ES" a command that is not known."""
    (answer,) = EmulatedPolledGauge(Cell(force), "mt_sics").exchange(command, 0.0, 9600)
    assert answer.data == expected


def lines(force, rate_hz, seconds=10.0):
    """What a board with bogde's example, without its delay, prints in a while [s] after its first line."""
    board = EmulatedBoard(Cell(force), "bogde_no_delay", rate_hz)
    board.opened(0.0)
    board.exchange(b"", 5.0, 57600)
    polls = range(1, round(1e3 * seconds) + 1)
    chunks = [chunk for poll in polls for chunk in board.exchange(b"", 5.0 + 1e-3 * poll, 57600)]
    return b"".join(chunk.data for chunk in chunks).splitlines()


@pytest.mark.parametrize("rate_hz", [10, 80])
def test_an_hx711_converts_as_often_as_its_libraries_say(rate_hz):
    """RobTillaart/HX711 fac13f0, README, "10 or 80 SPS"."""
    assert len(lines(1.0, float(rate_hz))) == pytest.approx(10 * rate_hz, abs=1)


@pytest.mark.parametrize(("force", "code"), [(math.inf, 0x7FFFFF), (-math.inf, 0x800000 - (1 << 24))])
def test_an_hx711_beyond_its_range_shows_its_last_code(force, code):
    """olkal/HX711_ADC 7762bc4, src/HX711_ADC.cpp: "The HX711 output range is min. 0x800000 and max. 0x7FFFFF"."""
    assert lines(force, 10.0)[-1] == b"HX711 reading: %d" % code
    assert counts_of(force) == code
