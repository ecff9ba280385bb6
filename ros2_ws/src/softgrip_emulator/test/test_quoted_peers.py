# SPDX-License-Identifier: Apache-2.0
"""Facts of the emulated devices beside what other people's programs and measurements say, quoted with their places."""

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml

from softgrip_emulator import damiao
from softgrip_emulator.damiao import motor as damiao_motor
from softgrip_emulator.damiao.motor import EmulatedDamiaoMotor
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.motion import ServoDrive
from softgrip_emulator.dynamixel.servo import EmulatedHardwareError, EmulatedServo, Shaft
from softgrip_emulator.dynamixel.table import available_models, load_model
from softgrip_emulator.feetech import memory as feetech_memory
from softgrip_emulator.feetech.servo import DUTY_PER_RAD, EmulatedFeetechServo
from softgrip_emulator.plant.motor import Motor
from softgrip_emulator.rig.amplifier import EmulatedAmplifier, counts_of
from softgrip_emulator.rig.emulated import EmulatedRig
from softgrip_emulator.rig.mark10_gauge import EmulatedMark10Gauge
from softgrip_emulator.rig.mark10_stand import EmulatedMark10Stand
from softgrip_emulator.rig.plant import RigPlant
from softgrip_emulator.rig.polled import EmulatedPolledGauge
from softgrip_emulator.rig.sketches import CLOCK_RATIO, EmulatedBoard
from softgrip_emulator.rig.truth import RigTruth
from softgrip_emulator.servos import load_ratings
from softgrip_emulator.thermometer import OFFSET_STDDEV_K

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


@pytest.mark.parametrize(("rate_hz", "seen_hz"), [(10.0, 11.67), (80.0, 92.0), (80.0, 93.7)])
def test_an_hx711_converts_as_often_as_its_users_saw(rate_hz, seen_hz):
    """olkal/HX711_ADC issues 80 ("conversion time ms: 85.72"), 29 ("almost 92SPS") and 98 ("sampling rate HZ: 93.70").

    Its data sheet says 10 and 80; "the HX711 internal clock is not accurate and will usually run a bit faster" (98).
    """
    assert len(lines(1.0, rate_hz, 100.0)) == pytest.approx(100.0 * seen_hz, rel=0.02)


def test_bogde_s_full_example_shows_raw_counts_also_after_its_tare():
    """squix78/esp8266-projects issue 6, after the tare: "read: -89620 read average: -89552 get value: -42.00".

    There get_value() is of two decimals, as Serial prints a double; get_units() of one.
    """
    board = EmulatedBoard(Cell(1.0), "bogde_full", 80.0)
    board.opened(0.0)
    said = b"".join(chunk.data for chunk in board.exchange(b"", 10.0, 38400)).decode().split("\r\n")
    after = said[said.index("After setting up the scale:") + 1 :][:4]
    shown = dict(line.split(": \t\t") for line in after)
    assert abs(int(shown["read"])) > 1000
    assert abs(int(shown["read average"])) > 1000
    assert shown["get value"].partition(".")[2] == "00"
    assert abs(float(shown["get value"])) < 100.0
    assert len(shown["get units"].partition(".")[2]) == 1


@pytest.mark.parametrize(("force", "code"), [(math.inf, 0x7FFFFF), (-math.inf, 0x800000 - (1 << 24))])
def test_an_hx711_beyond_its_range_shows_its_last_code(force, code):
    """olkal/HX711_ADC 7762bc4, src/HX711_ADC.cpp: "The HX711 output range is min. 0x800000 and max. 0x7FFFFF"."""
    assert lines(force, 10.0)[-1] == b"HX711 reading: %d" % code
    assert counts_of(force) == code


@pytest.mark.parametrize(("goal_a", "duty"), [(0.020, 0.172), (0.050, 0.489)])
def test_present_pwm_under_a_goal_current_is_what_is_applied(goal_a, duty):
    """Rhoban/bam issue 14 (efunn, 2026-09-02): XL330-M288 at 5.2 V, mode 0, bare horn, duty beside Present Current.

    One that showed what is asked for would show 1. Theirs rubs more: ours turns with 1.5 to 2.3 times their duty.
    """
    motor = Motor(load_model("xl330_m288").motor, Shaft(supply_v=5.2), spool_radius_m=0.010)
    for _ in range(1000):
        motor.step(ServoDrive(1.0, goal_a, limits_supply=True), 0.0, 5.2, 1e-3)
    assert motor.shaft.supply_current_a == pytest.approx(goal_a, rel=0.02)
    assert 1.4 * duty < motor.shaft.duty < 2.4 * duty


@pytest.mark.parametrize("name", ["xc330_m288", "xc330_t288"])
@pytest.mark.parametrize(("resistance", "time_s"), [(6.0, 5.0), (10.0, 5.6)])
def test_a_coreless_winding_leads_its_motor_s_heat_as_faulhaber_s_do(name, resistance, time_s):
    """Faulhaber's data sheets of series 1331 SR (13 mm) and 1524 SR (15 mm): Rth1 [K/W], tau_w1 [s].

    XC330: "Coreless DC" in the e-manual. XL330: "Cored"; its iron is heated with the copper, so it takes longer.
    """
    motor, cored = load_model(name).motor, load_model("xl330_m288").motor
    assert motor.winding_to_case_k_per_w == pytest.approx(resistance, rel=0.35)
    assert motor.winding_to_case_k_per_w * motor.winding_capacity_j_per_k == pytest.approx(time_s, rel=0.07)
    assert cored.winding_to_case_k_per_w * cored.winding_capacity_j_per_k > time_s


@pytest.mark.parametrize("name", ["xl430_w250", "xc430_w150", "xc430_w240", "xm430_w350", "xm540_w270"])
def test_a_greater_winding_leads_its_heat_between_a_smaller_and_a_greater_motor_s(name):
    """PR2/pr2_ethercat_drivers, motor_heating_model's test, as the caster's motor: 1.93 K/W, 41.6 s; Faulhaber 1524."""
    motor = load_model(name).motor
    assert 1.93 < motor.winding_to_case_k_per_w < 10.0
    assert 5.6 < motor.winding_to_case_k_per_w * motor.winding_capacity_j_per_k < 41.6


@pytest.mark.parametrize(
    ("ours", "inertia", "friction", "factor"),
    [("xm540_w150", 0.01195, 0.09039, 1.3), ("xm540_w270", 0.02661, 0.10352, 2.0)],
)
def test_an_xm540_turns_as_the_mx_of_its_size_was_identified(ours, inertia, friction, factor):
    """Rhoban/bam 1b5a1ce, params/mx64/m1.json, mx106/m1.json: armature [kg m^2], friction_base [N m].

    The W270, which the W150 is scaled from, is half as heavy again and rubs twice as much.
    """
    motor = load_model(ours).motor
    assert inertia <= motor.inertia_kgm2 < 1.55 * inertia
    assert friction <= motor.gear_friction_nm < factor * friction


@pytest.mark.parametrize(
    ("name", "share", "settings"),
    [
        ("xm430_w350", 0.941 / 2.3, {}),
        ("xm430_w350", 0.47, {}),
        ("xm540_w270", 0.45, {}),
        ("xl330_m288", 0.41, {"trips_early": True}),
    ],
)
def test_an_overload_trips_where_users_saw_it(name, share, settings):
    """An XM430 at 12 V, 941 mA for "around 5s", "the motor goes into overload" (ROBOTIS-GIT/DynamixelSDK issue 285).

    An XM430 at 47 % of its stall (jsk-ros-pkg/jsk_aerial_robot issue 281), an XW540 at 45 % (ROBOTIS forum 8128).
    """
    assert tripped_s(name, share, **settings) == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(("name", "share"), [("xm540_w270", 0.12), ("xl330_m288", 0.5)])
def test_what_nobody_saw_shutting_down_goes_on(name, share):
    """An XH540 at 12 % of its stall goes on (ROBOTIS forum); of an XL330 nothing was found."""
    assert math.isinf(tripped_s(name, share))


def tripped_s(name, share, **settings):
    """When an overload shuts a servo down [s]."""
    servo = EmulatedServo(load_model(name), 1, **settings)
    servo.shaft.current_a = share * servo.model.motor.stall_current_a
    for step in range(2000):
        servo.step(0.01 * step, 0.01)
        if servo.registers.get("hardware_error_status") & EmulatedHardwareError.OVERLOAD:
            return 0.01 * step
    return math.inf


@pytest.mark.parametrize("name", ["xc430_w150", "xc430_w240"])
def test_an_xc430_answers_at_five_volts_with_an_input_voltage_error(name):
    """HaddingtonDynamics/Dexter issue 94: at 5 V "r 0 #Servo 1 70 1" "returns 1 which is 'Input Voltage Error'"."""
    servo = EmulatedServo(load_model(name), 1)
    servo.shaft.supply_v = 5.0
    servo.step(0.0, 0.001)
    assert servo.powered
    assert servo.registers.get("hardware_error_status") == EmulatedHardwareError.INPUT_VOLTAGE


def test_a_goal_switches_an_sts3215_on_as_its_users_found():
    """tomwhipple/biped-robot, docs/servo-map.md, register 42: "a write auto-enables torque"."""
    servo = EmulatedFeetechServo(feetech_memory.load_model("STS3215"), 1)
    assert not servo.holds
    servo.write(42, (2048).to_bytes(2, "little"))
    assert servo.holds


def test_an_sts3215_draws_without_load_as_its_sister_for_12_v():
    """STS3215-C018's sheet by tomwhipple/biped-robot, docs/servo-map.md: "stall 2.7 A, no-load running 180 mA"."""
    ratings = load_ratings("STS3215")
    speed = ratings.no_load_speed_rpm * math.tau / 60.0
    friction_nm = ratings.gear_friction_nm + ratings.gear_viscous_nms * speed
    share = friction_nm / ratings.torque_constant_nm_per_a / ratings.stall_current_a
    assert share == pytest.approx(0.180 / 2.7, rel=0.10)


def test_a_damiao_has_the_winding_of_its_maker_s_manual():
    """dmBots/DM-J4310-2EC 1f80c57, manual V1.1 of 2023-11-16, p. 9: 650 mohm, 340 uH, 14 pole pairs, 200 rpm."""
    model = damiao_motor.load_model("DM-J4310-2EC")
    registers = {row[0]: row[3] for row in model.registers.values()}
    assert registers["rs"] == 0.650
    assert model.motor.resistance_ohm == pytest.approx(0.650, rel=0.002)
    assert registers["ls"] == pytest.approx(340e-6, rel=0.02)
    assert (registers["npp"], registers["gr"], model.motor.no_load_speed_rpm) == (14, 10.0, 200.0)


def turning_damiao(ki_asr, asked_rad_s=5.0, load_n=10.0):
    """Return the speed [rad/s] of a motor that turns a load on 10 mm in its speed mode, after two seconds."""
    described = damiao_motor.load_model("DM-J4310-2EC")
    firmware = EmulatedDamiaoMotor(described, 1)
    firmware.registers.put("ctrl_mode", 3)
    firmware.registers.put("ki_asr", ki_asr)
    motor = Motor(described.motor, firmware.shaft, spool_radius_m=0.010)
    firmware.receive(0x201, b"\xff" * 7 + b"\xfc", 0.0)
    firmware.receive(0x201, struct.pack("<f4x", asked_rad_s), 0.0)
    for step in range(4000):
        motor.step(firmware.step(5e-4 * step, 5e-4), load_n, 24.0, 5e-4)
    return firmware.shaft.velocity_rad_s


def test_a_damiao_s_speed_loop_leaves_nothing_over_once_it_has_its_integral():
    """damiao-motor 1.0.6, its table: 26 KI_ASR, "speed loop Ki". Without one a load keeps the motor behind."""
    assert turning_damiao(0.002) == pytest.approx(5.0, rel=1e-3)
    assert turning_damiao(0.0) < 0.97 * 5.0


def test_a_damiao_that_was_held_up_is_soon_as_quick_as_asked_again():
    """What its integral has summed up while the shaft stood is no more than its largest current gives."""
    described = damiao_motor.load_model("DM-J4310-2EC")
    firmware = EmulatedDamiaoMotor(described, 1)
    firmware.registers.put("ctrl_mode", 3)
    motor = Motor(described.motor, firmware.shaft, spool_radius_m=0.010)
    firmware.receive(0x201, b"\xff" * 7 + b"\xfc", 0.0)
    firmware.receive(0x201, struct.pack("<f4x", 5.0), 0.0)
    for step in range(10_000):
        motor.jammed = step < 8000  # 4 s
        motor.step(firmware.step(5e-4 * step, 5e-4), 0.0, 24.0, 5e-4)
    assert firmware.shaft.velocity_rad_s == pytest.approx(5.0, rel=0.1)


def test_a_damiao_rubs_as_openarm_has_it_and_is_lighter():
    """enactic/openarm_mujoco 56e846b, v2/openarm_bimanual.xml, motor_DM4310: frictionloss, armature.

    Its inertia is 5.6 times the data sheet's rotor by the gears; its damping (0.9) holds the simulation.
    """
    ratings = load_ratings("DM-J4310-2EC")
    assert ratings.gear_friction_nm == pytest.approx(0.04, abs=0.02)
    assert 0.0100 / ratings.inertia_kgm2 == pytest.approx(5.6, abs=0.1)


def test_a_damiao_lets_go_when_no_order_comes_as_its_manual_says():
    """The same manual: without a CAN order for the set time it leaves the enabled mode (error D)."""
    motor = EmulatedDamiaoMotor(damiao_motor.load_model("DM-J4310-2EC"), 1)
    motor.registers.put("timeout", 2000)
    motor.receive(1, b"\xff" * 7 + b"\xfc", 0.0)
    motor.step(0.09, 0.001)
    assert motor.holds
    motor.step(0.11, 0.001)
    assert not motor.holds


def test_an_uno_boots_a_little_longer_than_its_boot_loader_waits():
    """Optiboot/optiboot 00fe371, optiboot.c: WATCHDOG_1S behind six turns of the LED, 1/16 s each (flash_led)."""
    board = EmulatedBoard(Cell(1.0), "bogde_no_delay", 80.0)
    board.opened(0.0)
    boot_s = board.due_s() - 1.0 / (CLOCK_RATIO * 80.0)
    assert 1.0 + 6.0 / 16.0 < boot_s < 1.2 * (1.0 + 6.0 / 16.0)


def test_an_hx711_scatters_as_its_users_saw_and_a_gauge_by_a_digit():
    """roger-random.github.io, "Observations on 24 Hours of HX711 Data": "roughly 350 sensor counts" within a minute.

    Of 120 readings a minute normal noise spans 5.1 standard deviations: 69 counts; Arduino forum 351959: 110. Ours is
    the greater, and that of a Mark-10 gauge, whose digit is 1/5000 of 50 N, seven times that.
    """
    readings = np.array([int(line.split()[-1]) for line in lines_of_a_rig("bogde_no_delay")])
    assert 350.0 / 5.1 < readings.std() < 1.15 * 110.0
    noise = RigTruth.__dataclass_fields__["gauge_noise"].default
    assert noise == pytest.approx(50.0 / 5000)


def lines_of_a_rig(gauge):
    """What the board of an emulated rig prints in ten seconds."""
    rig = EmulatedRig(gauge=gauge)
    rig.gauge.opened(0.0)
    chunks = [rig.gauge.exchange(b"", 5.0 + 1e-3 * poll, 57600) for poll in range(10_000)]
    return b"".join(chunk.data for some in chunks for chunk in some).splitlines()[1:-1]


def test_an_openscale_says_what_its_users_read():
    """DAsh0244/pi_control 1c1cb57, sparkfun_openscale.py: report_rate 200 [ms], "[9600 bps]".

    Scale Manager (M. Kohls, 2018): "time,weight,units,temperature,".
    """
    scale = EmulatedAmplifier(Cell(9.81), "openscale")
    scale.opened(0.0)
    (line,) = scale.exchange(b"", scale.due_s(), 9600)
    time_ms, weight, units, temperature, rest = line.data.removesuffix(b"\r\n").split(b",")
    assert (int(time_ms), float(weight), units, rest) == (200, 1.0, b"kg", b"")
    assert float(temperature) > 0.0


def test_three_thermometers_differ_as_three_bme280_did():
    """community.particle.io, "BME280 vs TMP36": "The biggest difference in the BME280s was about 0.7 degrees".

    Three of a normal distribution span 1.69 standard deviations on the average.
    """
    assert pytest.approx(0.7, rel=0.25) == 1.69 * OFFSET_STDDEV_K


@pytest.mark.parametrize("force", [21.15, -11.70, 0.3])
def test_a_sauter_answers_as_an_fh_500_does(force):
    """Dynteq/far-500, FAR-500_ESP32C6_v5.1.ino, sauterParse: 7 characters without CR or LF, '1' ahead is plus."""
    (answer,) = EmulatedPolledGauge(Cell(force), "sauter").exchange(b"9", 0.0, 9600)
    assert len(answer.data) == 7
    magnitude = float(answer.data[1:])
    assert (magnitude if answer.data[:1] == b"1" else -magnitude) == pytest.approx(force, abs=0.005)


#: ToddlerBot's servos: Coulomb friction [N m], viscous friction [N m s], inertia [kg m^2], each with its share of ours.
TODDLERBOT = {
    "xc330_t288": ((0.006, 0.6), (0.001, 0.5), (0.0048, 4.8)),
    "xm430_w350": ((0.105, 1.31), (0.0133, 0.67), (0.0025, 0.21)),
    "xm430_w210": ((0.038, 0.79), (0.0064, 0.89), (0.0022, 0.51)),
    "xc430_w240": ((0.014, 0.33), (0.0072, 1.11), (0.0044, 0.76)),
    "xl430_w250": ((0.069, 2.23), (0.0013, 0.22), (0.0083, 1.30)),
}


@pytest.mark.parametrize("name", TODDLERBOT)
def test_toddlerbot_s_servos_are_as_far_from_ours_as_docs_say(name):
    """google-deepmind/mujoco_menagerie 24b360ce, toddlerbot_2xm.xml, classes XC330, XM430-W350, -W210, XC430, 2XL430.

    Attributes frictionloss, damping, armature. An XC330 is 4.8 times as heavy as assumed, a W350 a fifth.
    """
    motor = load_model(name).motor
    ours = (motor.gear_friction_nm, motor.gear_viscous_nms, motor.inertia_kgm2)
    for own, (theirs, share) in zip(ours, TODDLERBOT[name], strict=True):
        assert theirs / own == pytest.approx(share, abs=0.01)


def test_an_xm430_begins_to_turn_below_what_interbotix_lets_stand():
    """Interbotix/interbotix_ros_manipulators a4b7e511, motor_specs_wx250s.yaml, waist: 1.793 N m/A, no load 0.1 A.

    "should be as large as possible without the joint accelerating by itself"; its bearing rubs, too.
    """
    motor = load_model("xm430_w350").motor
    assert motor.stall_torque_nm / motor.stall_current_a == pytest.approx(1.793, rel=0.01)
    assert 1.793 * 0.1 / motor.gear_friction_nm == pytest.approx(2.24, abs=0.02)


@pytest.mark.parametrize(("name", "seen_c", "missing_k"), [("xl330_m288", 23.0, -1.0), ("xc330_t288", 45.0, 21.0)])
def test_an_idle_servo_stays_as_cool_as_an_xl330_and_cooler_than_an_xc330(name, seen_c, missing_k):
    """ROBOTIS forum 1992: at idle "Most are in the 45-55c range", "the XL330-M288 servos all sit at around 17-23c"."""
    motor = Motor(load_model(name).motor, Shaft(), spool_radius_m=0.010)
    for _ in range(36_000):
        motor.step(ServoDrive(), 0.0, motor.ratings.nominal_voltage_v, 0.1)
    assert seen_c - motor.shaft.temperature_c == pytest.approx(missing_k, abs=0.5)


@pytest.mark.parametrize(("gap_s", "forgotten"), [(0.02, False), (0.6, True)])
def test_an_interrupted_packet_is_forgotten_as_robotis_parser_forgets(gap_s, forgotten):
    """ROBOTIS-GIT/DynamixelShield 84f513c, src/util/dxl.cpp: rx_timeout 500*1000 [us]; ours after 50 ms.

    A gap of 20 ms is short to both, one of 600 ms long.
    """
    chain = DynamixelChain([EmulatedServo(load_model("xl330_m288"), 1)])
    chain.opened(0.0)
    ping = bytes.fromhex("fffffd0001030001194e")
    chain.exchange(ping[:6], 1.0, 57600)
    assert bool(chain.exchange(ping[6:], 1.0 + gap_s, 57600)) is not forgotten
    assert chain.exchange(ping, 3.0, 57600)


def test_an_sts3215_keeps_a_goal_beyond_its_limits_and_turns_to_the_nearer_one():
    """huggingface/lerobot issue 3585 (0o8o0-blip, 2026-05-12): "internally clamping the goal to the nearest edge".

    "The `Goal_Position` register itself is left at the value the host wrote".
    """
    described = feetech_memory.load_model("STS3215")
    servo = EmulatedFeetechServo(described, 1)
    servo.write(9, struct.pack("<HH", 500, 1000))
    motor = Motor(described.motor, servo.shaft, spool_radius_m=0.010)
    servo.write(42, struct.pack("<H", 3000))
    assert servo.holds
    for step in range(5000):
        motor.step(servo.step(1e-3 * step, 1e-3), 0.0, 7.4, 1e-3)
    assert servo.read(42, 2) == struct.pack("<H", 3000)
    assert servo.status == 0
    (position,) = struct.unpack("<H", servo.read(56, 2))
    assert position == pytest.approx(1000, abs=5)


def test_an_sts3215_has_nothing_where_lerobot_has_seven_more_items():
    """huggingface/lerobot 7427f31, motors/feetech/tables.py, "# Factory": Moving_Velocity_Threshold (80) to 86.

    OneLif2/ft_serial_servo_motor, README: read_all_info "requires all 87 bytes data from the servo".
    """
    servo = EmulatedFeetechServo(feetech_memory.load_model("STS3215"), 1)
    everything = servo.read(0, 87)
    assert len(everything) == 87
    assert everything[3:5] == struct.pack("<H", 777)
    assert everything[80:] == bytes(7)


def said_by_gauge(command, force=0.0, gauge=None):
    """What a Mark-10 gauge says to a command."""
    gauge = gauge or EmulatedMark10Gauge(Cell(force))
    return b"".join(chunk.data for chunk in gauge.exchange(command, 0.0, 115200))


@pytest.mark.parametrize("force", [12.3, -18.78, 0.0])
def test_a_mark_10_gauge_says_what_opentrons_reads(force):
    r"""Opentrons/opentrons 08e382b, mark10_fg.py: 115200 baud, "?\r\n", 'return "12.3 N"', split(" "); N has no answer.

    Series 4 user's guide, 9.1.4: "4.285 N<CR><LF> 4.285 N of compression force"; ours pulls with a minus.
    """
    gauge = EmulatedMark10Gauge(Cell(force))
    assert said_by_gauge(b"N\r\n", gauge=gauge) == b""
    line = said_by_gauge(b"?\r\n", gauge=gauge)
    assert line.endswith(b"\r\n")
    value, unit = line.decode("utf-8").strip().split(" ")
    assert unit == "N"
    assert float(value) == pytest.approx(-force, abs=0.005)


@pytest.mark.parametrize(
    ("command", "code"),
    [(b"XYZ\r", b"*10\r\n"), (b"FLTCx\r", b"*12\r\n"), (b"AOUT999\r", b"*22\r\n")],
)
def test_a_mark_10_gauge_refuses_with_the_codes_of_its_guide(command, code):
    """Series 5 user's guide (Checkline), p. 19: "*10 Illegal command", "*12 Invalid specifier", *22 too large."""
    assert said_by_gauge(command) == code


def test_a_mark_10_gauge_lists_its_settings_as_its_guide_s_example():
    """The same page: "V1.00;LBF;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0".

    LabKit (Pluze/LabKit-MATLAB-Workbench 7099b62, decodeSettings.m) looks for ";" and AOUT, reads 2^FLTC samples.
    """
    gauge = EmulatedMark10Gauge(Cell(0.0))
    assert said_by_gauge(b"LB\rLIST\r", gauge=gauge) == b"V1.00;LBF;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0\r\n"
    tokens = said_by_gauge(b"FLTC3\rAOUT25\rLIST\r", gauge=gauge).strip().split(b";")
    assert {b"FLTC3", b"AOUT25"} <= set(tokens)


@pytest.mark.parametrize(("unit", "known"), [(b"LB", b"LBF"), (b"N", b"N"), (b"KG", b"KGF"), (b"OZ", b"OZF")])
def test_a_mark_10_gauge_lists_its_unit_as_labkit_knows_it(unit, known):
    """LabKit, decodeSettings.m: "LBF", "OZF", "KGF", "GF", "N", "MN", "KN"; and IPOL1, which ours does not list."""
    listed = said_by_gauge(unit + b"\rIPOL1\rLIST\r").strip().split(b";")
    assert listed[1] == known
    assert b"IPOL1" not in listed
    assert said_by_gauge(unit + b"\r?\r").strip().split()[1].upper() == known


def test_a_mark_10_gauge_s_zero_is_as_good_as_labkit_asks():
    """LabKit 1159a04, zeroForce.m: after Z a reading of ?C is good within two displayed increments."""
    cell = EmulatedRig(gauge="gcl2").cell
    good = 0
    for trial in range(1000):
        cell.tare(0.1 * trial)
        good += abs(round(cell.read(0.1 * trial + 0.05), 2)) < 0.025
    assert good / 1000 == pytest.approx(0.92, abs=0.03)


def said_by_stand(orders, force=0.0):
    """What a Mark-10 stand says to its orders, and the lines of it."""
    stand = EmulatedMark10Stand(RigPlant(RigTruth.from_seed(1), 1), Cell(force))
    return b"".join(chunk.data for chunk in stand.exchange(orders, 0.0, 115200))


def test_a_mark_10_stand_says_force_and_travel_as_labkit_reads_them():
    r"""LabKit 1159a04, decodeSample.m: "1.000 N", then "2.00 mm"; mark10TravelReading.m: the pattern.

    Orders have no end: "sends fixed ESM303 commands without adding a terminator".
    """
    force, travel = said_by_stand(b"zn", force=-1.0).decode().splitlines()
    assert re.fullmatch(r"[-+]?\d+\.\d+ N", force)
    assert float(force.split()[0]) == pytest.approx(1.0, abs=0.005)
    assert travel == "0.00 mm"
    assert re.fullmatch(r"([-+]?\d+(?:\.\d+)?)\s*(mm|in)", said_by_stand(b"x").decode().strip())


def test_a_mark_10_stand_says_and_hears_inches_by_their_digits():
    """LabKit's Mark10FacadeSpec: "0.125 in". ESM303 guide, 6.2: "e02.85 = 2.85 in/min"; in millimetres "e0200.3"."""
    assert re.fullmatch(rb"-?\d+\.\d{3} in\r\n", said_by_stand(b"bx"))
    assert said_by_stand(b"be02.85a").startswith(b"72.4")  # 2.85 x 25.4
    assert said_by_stand(b"bh01.500v").startswith(b"1.500 in")
    assert said_by_stand(b"e0200.3a").startswith(b"200.3")
    assert said_by_stand(b"e02.85a") == said_by_stand(b"be0200.3a") == said_by_stand(b"a")


@pytest.mark.parametrize("orders", [b"p", b"lp", b"lh000.00p", b"lup", b"up", b"dp"])
def test_a_mark_10_stand_says_one_code_as_labkit_expects(orders):
    """LabKit 1159a04, zeroTravel.m: the whole reply to p is U, D, S, C, L, M, UL or DL, the codes of the guides."""
    assert said_by_stand(orders).decode().strip() in {"U", "D", "S", "C", "L", "M", "UL", "DL"}


def test_a_scale_sends_as_often_as_adafruit_s_and_what_selleton_s_does():
    """Adafruit, "Digital shipping scales": a 7010SB "spits out data every 1/10 second".

    Selleton SL-7516, p. 16: S1 ST, US or OL; S2 GS or NT; S3 "+" or "-"; data; kg; CR LF.
    """
    scale = EmulatedAmplifier(Cell(9.81), "scale")
    scale.opened(0.0)
    assert scale.due_s() == pytest.approx(0.1)
    (line,) = scale.exchange(b"", scale.due_s(), 9600)
    state, kind, weight = line.data.removesuffix(b"kg\r\n").split(b",")
    assert (state, kind, float(weight.replace(b" ", b""))) == (b"ST", b"GS", 1.0)
    assert weight.startswith(b"+")
    over = EmulatedAmplifier(Cell(math.inf), "scale")
    over.opened(0.0)
    assert over.exchange(b"", 0.1, 9600)[0].data.startswith(b"OL,GS,")
