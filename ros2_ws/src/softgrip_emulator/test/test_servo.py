# SPDX-License-Identifier: Apache-2.0
"""What a servo's firmware does beyond its table (e-manual notes and users' reports)."""

import math

import pytest

from softgrip_emulator.dynamixel.packets import ALERT, Instruction, Packet, StatusError
from softgrip_emulator.dynamixel.servo import REBOOT_SILENCE_S, EmulatedHardwareError, EmulatedServo
from softgrip_emulator.dynamixel.table import available_models, load_model
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.servos import factory_settings

MODELS = available_models()
WITHOUT_CURRENT = ["xc430_w150", "xc430_w240", "xl430_w250"]


@pytest.fixture(params=MODELS)
def servo(request):
    return EmulatedServo(load_model(request.param), 7)


@pytest.fixture(params=[name for name in MODELS if name not in WITHOUT_CURRENT])
def current_servo(request):
    return EmulatedServo(load_model(request.param), 7)


@pytest.fixture(params=WITHOUT_CURRENT)
def load_servo(request):
    return EmulatedServo(load_model(request.param), 7)


def do(servo, instruction, parameters=b"", now_s=0.0):
    return servo.execute(Packet(servo.device_id, instruction, parameters), now_s)


def test_models_are_those_of_the_cell():
    x330, xm = ["xc330_m288", "xc330_t288"], ["xm430_w210", "xm430_w350", "xm540_w150", "xm540_w270"]
    assert [*x330, *WITHOUT_CURRENT[:2], "xl330_m288", WITHOUT_CURRENT[2], *xm] == MODELS


# model number, current limit, temperature limit, position P gain: e-manual control tables
@pytest.mark.parametrize(
    ("name", "number", "current_limit", "temperature_limit", "p_gain", "shutdown"),
    [
        ("XL330-M288", 1200, 1750, 70, 400, 0x35),
        ("XC330-M288", 1240, 2352, 70, 1100, 0x34),
        ("XC330-T288", 1220, 910, 70, 900, 0x34),
        ("XM430-W350", 1020, 1193, 80, 800, 0x34),
        ("XM540-W150", 1130, 2047, 80, 800, 0x34),
        ("XM540-W270", 1120, 2047, 80, 800, 0x34),
        ("XL430-W250", 1060, None, 72, 640, 0x34),
        ("XC430-W150", 1070, None, 80, 460, 0x34),
        ("XC430-W240", 1080, None, 80, 700, 0x34),
    ],
)
def test_factory_values(name, number, current_limit, temperature_limit, p_gain, shutdown, read):
    servo = EmulatedServo(load_model(name), 1)
    names = ("model_number", "temperature_limit", "position_p_gain", "shutdown", "return_delay_time")
    assert [read(servo, item) for item in names] == [number, temperature_limit, p_gain, shutdown, 250]
    assert (read(servo, "current_limit") if servo.registers.has("current_limit") else None) == current_limit
    assert do(servo, Instruction.PING).parameters[:2] == number.to_bytes(2, "little")


def test_the_velocity_limit_of_an_x330_goes_to_2047_and_that_of_an_x430_to_1023(servo, write):
    """e-manual, Velocity Limit(44) of the X330 pages and of the XM430's."""
    largest = 2047 if servo.model.senses_supply_current else 1023
    assert write(servo, "velocity_limit", largest) == 0
    assert write(servo, "velocity_limit", largest + 1) == StatusError.DATA_RANGE


def test_an_x430_says_whether_its_backup_is_ready(servo):
    """Backup Ready(147): X330 since firmware 46, XM430 and XM540 since 45."""
    assert servo.registers.has("backup_ready")


@pytest.mark.parametrize(("firmware", "entries", "data"), [(52, 20, 208), (53, 28, 224)])
def test_the_indirect_block_of_an_x330_moved_with_firmware_53(firmware, entries, data):
    """ROBOTIS-GIT/dynamixel_hardware_interface, param/dxl_model: xl330_m288_fw52.model and xl330_m288.model."""
    servo = EmulatedServo(load_model("XL330-M288", firmware), 1)
    (block,) = servo.model.indirect
    assert (block.addresses, block.count, block.data) == (168, entries, data)
    assert servo.registers.get("indirect_address_168") == data
    assert servo.registers.get("firmware_version") == firmware


def test_a_servo_without_current_reports_its_load_and_knows_four_modes(load_servo, read, write):
    """XL430 and XC430 pages: Present Load(126), "inferred from the internal output value"; modes 1, 3, 4 and 16."""
    load_servo.shaft.current_a, load_servo.shaft.duty = 0.4, -0.25
    assert read(load_servo, "present_load") == -250
    accepted = [mode for mode in range(17) if write(load_servo, "operating_mode", mode) == 0]
    assert accepted == [1, 3, 4, 16]
    for address in (38, 102):
        assert load_servo.write_for_host(address, bytes(2), 0.0).error == StatusError.ACCESS


def test_goal_pwm_limits_what_position_control_puts_out(servo, write):
    """e-manual, Goal PWM(100): "in other control modes, this value is used to limit PWM value"."""
    write(servo, "operating_mode", 4)
    write(servo, "torque_enable", 1)
    write(servo, "goal_pwm", 88)
    write(servo, "goal_position", 4000)
    duty = servo.step(0.001, 0.001).duty
    assert duty == pytest.approx(88 / 885)
    write(servo, "goal_position", -4000)
    assert servo.step(0.002, 0.001).duty == pytest.approx(-88 / 885)


def test_a_servo_reports_the_current_that_its_model_senses(current_servo, read):
    """Notes of Current Limit(38) in the e-manual: X330 at the power input, where the duty cycle's share of it flows."""
    servo = current_servo
    servo.shaft.current_a, servo.shaft.duty = 0.4, 0.25
    shown = read(servo, "present_current") * servo.model.motor.current_unit_a
    assert shown == pytest.approx(
        0.1 if servo.model.senses_supply_current else 0.4, abs=servo.model.motor.current_unit_a
    )
    assert servo.model.senses_supply_current == ("330" in servo.model.name)


def test_eeprom_is_closed_while_torque_is_on(servo, write):
    assert write(servo, "torque_enable", 1) == 0
    assert write(servo, "return_delay_time", 0) == StatusError.ACCESS
    assert write(servo, "torque_enable", 0) == 0
    assert write(servo, "return_delay_time", 0) == 0


@pytest.mark.parametrize(
    ("item", "value", "error"),
    [
        ("return_delay_time", 255, StatusError.DATA_RANGE),
        ("operating_mode", 2, StatusError.DATA_RANGE),
        ("goal_position", 4096, StatusError.DATA_LIMIT),
        ("goal_position", -1, StatusError.DATA_LIMIT),
        ("goal_pwm", 886, StatusError.DATA_LIMIT),
        ("goal_velocity", -1000, StatusError.DATA_LIMIT),
        ("present_position", 0, StatusError.ACCESS),
        ("model_number", 1, StatusError.ACCESS),
    ],
)
def test_rules_of_the_table(servo, write, item, value, error):
    assert write(servo, item, value) == error


def test_a_goal_current_beyond_its_limit_is_refused(current_servo, write):
    assert write(current_servo, "goal_current", 3000) == StatusError.DATA_LIMIT


def test_too_few_bytes_and_undefined_addresses(servo):
    assert servo.write_for_host(116, b"\x00\x00", 0.0).error == StatusError.DATA_LENGTH
    assert servo.write_for_host(118, b"\x00\x00", 0.0).error == StatusError.ACCESS
    assert servo.write_for_host(15, b"\x00", 0.0).error == StatusError.ACCESS
    assert servo.write_for_host(60000, b"\x00", 0.0).error == StatusError.ACCESS
    assert servo.read_for_host(15, 1, 0.0).error == StatusError.ACCESS
    assert servo.read_for_host(60000, 4, 0.0).error == StatusError.ACCESS
    assert servo.read_for_host(132, 0, 0.0).error == StatusError.ACCESS


def test_a_refused_write_changes_nothing(current_servo, read):
    servo = current_servo
    # goal current (fine) and goal velocity (beyond its limit) in one write
    before = read(servo, "goal_current")
    assert servo.write_for_host(102, bytes.fromhex("0100 FFFFFF7F"), 0.0).error == StatusError.DATA_LIMIT
    assert read(servo, "goal_current") == before


def test_changing_the_mode_resets_profile_gains_and_goals(servo, read, write):
    for item, value in (("profile_velocity", 50), ("profile_acceleration", 9), ("position_p_gain", 5)):
        assert write(servo, item, value) == 0
    assert write(servo, "goal_pwm", 80) == 0
    assert write(servo, "operating_mode", 4) == 0
    assert read(servo, "profile_velocity") == read(servo, "profile_acceleration") == 0
    assert read(servo, "position_p_gain") != 5
    assert read(servo, "goal_pwm") == 885


def test_changing_the_mode_puts_the_goal_current_to_its_limit(current_servo, read, write):
    assert write(current_servo, "goal_current", 10) == 0
    assert write(current_servo, "operating_mode", 5) == 0
    assert read(current_servo, "goal_current") == read(current_servo, "current_limit")


def turn(servo, turns):
    servo.shaft.angle_rad = turns * 2 * math.pi


def test_turns_are_counted_until_the_power_goes(servo, read, write):
    write(servo, "operating_mode", 4)
    turn(servo, 3.25)
    assert read(servo, "present_position") == 13312
    do(servo, Instruction.REBOOT)
    assert read(servo, "present_position", REBOOT_SILENCE_S) == 1024
    turn(servo, 2.0)
    assert read(servo, "present_position") == 1024 - 5120


@pytest.mark.parametrize("how", ["mode", "torque", "clear"])
def test_other_ways_to_lose_the_turns(servo, read, write, how):
    write(servo, "operating_mode", 3 if how == "torque" else 4)
    turn(servo, -1.75)
    if how == "mode":
        write(servo, "operating_mode", 3)
    elif how == "torque":
        write(servo, "torque_enable", 1)
    else:
        assert do(servo, Instruction.CLEAR, bytes.fromhex("0144584C22")).error == 0
    assert read(servo, "present_position") == 1024


def test_clear_is_refused_while_moving_and_without_its_key(servo):
    servo.shaft.velocity_rad_s = 3.0
    assert do(servo, Instruction.CLEAR, bytes.fromhex("0144584C22")).error == StatusError.RESULT_FAIL
    assert do(servo, Instruction.CLEAR, bytes(5)).error == StatusError.DATA_RANGE


def test_homing_offset_is_added_and_not_turned_by_reverse(servo, read, write):
    write(servo, "operating_mode", 4)
    write(servo, "homing_offset", 100)
    turn(servo, 0.25)
    assert read(servo, "present_position") == 1124
    write(servo, "drive_mode", 1)
    assert read(servo, "present_position") == -1024 + 100


def test_an_offset_beyond_a_quarter_turn_is_ignored_within_one_turn(servo, read, write):
    write(servo, "homing_offset", -1024)
    assert read(servo, "present_position") == -1024
    write(servo, "homing_offset", 1025)
    assert read(servo, "present_position") == 0
    write(servo, "operating_mode", 4)
    assert read(servo, "present_position") == 1025


def test_a_backup_brings_the_gains_back_at_a_start_where_it_is_asked_to(servo, read, write):
    """E-manual, "Backup and Restore": gains, profile and indirect addresses, no goal and no torque."""
    for item, value in (("position_p_gain", 321), ("profile_velocity", 45), ("goal_pwm", 800), ("led", 1)):
        assert write(servo, item, value) == 0
    assert do(servo, Instruction.CONTROL_TABLE_BACKUP, b"\x01" + bytes.fromhex("4354524C")).error == 0
    factory = load_model(servo.model.name)
    default = {item.name: item.default for item in factory.items}
    do(servo, Instruction.REBOOT)
    assert read(servo, "position_p_gain", 1.0) == default["position_p_gain"]
    assert write(servo, "startup_configuration", 2) == 0
    do(servo, Instruction.REBOOT)
    assert (read(servo, "position_p_gain", 2.0), read(servo, "profile_velocity", 2.0)) == (321, 45)
    assert (read(servo, "goal_pwm", 2.0), read(servo, "led", 2.0), read(servo, "torque_enable", 2.0)) == (885, 0, 0)


def test_a_servo_may_come_up_with_torque(servo, read, write):
    write(servo, "startup_configuration", 1)
    do(servo, Instruction.REBOOT)
    assert read(servo, "torque_enable", 1.0) == 1


def test_reboot_answers_then_is_silent(servo, read, write):
    write(servo, "torque_enable", 1)
    assert do(servo, Instruction.REBOOT, now_s=5.0).error == 0
    assert not servo.listens(5.0 + 0.9 * REBOOT_SILENCE_S, servo.baud)
    assert servo.listens(5.0 + 1.1 * REBOOT_SILENCE_S, servo.baud)
    assert read(servo, "torque_enable", 6.0) == 0
    assert read(servo, "realtime_tick", 6.0) == pytest.approx(1000 * (1.0 - REBOOT_SILENCE_S), abs=1)


def test_shutdown_takes_the_torque_until_a_reboot(servo, read, write):
    write(servo, "torque_enable", 1)
    servo.forced_error_bits = EmulatedHardwareError.OVERLOAD
    servo.step(0.001, 0.001)
    assert read(servo, "torque_enable") == 0
    assert servo.read_for_host(70, 1, 0.0).error == ALERT
    assert servo.read_for_host(70, 1, 0.0).parameters == bytes([EmulatedHardwareError.OVERLOAD])
    assert write(servo, "torque_enable", 1) == ALERT
    assert read(servo, "torque_enable") == 0
    do(servo, Instruction.REBOOT)
    servo.step(1.0, 0.001)
    assert read(servo, "hardware_error_status", 1.0) == 0
    assert write(servo, "torque_enable", 1, 1.0) == 0
    assert read(servo, "torque_enable", 1.0) == 1


def test_an_error_outside_the_shutdown_mask_only_alerts(servo, read, write):
    write(servo, "shutdown", 0)
    write(servo, "torque_enable", 1)
    servo.forced_error_bits = EmulatedHardwareError.OVERLOAD
    servo.step(0.001, 0.001)
    assert read(servo, "torque_enable") == 1
    assert do(servo, Instruction.PING).error == ALERT


def test_overload_and_heat_and_voltage_are_noticed(servo, read, write):
    write(servo, "torque_enable", 1)
    servo.shaft.current_a = servo.model.motor.stall_current_a
    borne = round(1e3 * servo.model.overload.seconds)
    for step in range(borne - 500):
        servo.step(step * 1e-3, 1e-3)
    assert read(servo, "hardware_error_status") == 0
    for step in range(borne - 500, borne + 500):
        servo.step(step * 1e-3, 1e-3)
    assert read(servo, "hardware_error_status") == EmulatedHardwareError.OVERLOAD
    servo.shaft.temperature_c = read(servo, "temperature_limit") + 1.0
    servo.shaft.supply_v = read(servo, "min_voltage_limit") / 10.0 - 0.3
    servo.step(8.0, 1e-3)
    expected = EmulatedHardwareError.OVERLOAD | EmulatedHardwareError.OVERHEATING | EmulatedHardwareError.INPUT_VOLTAGE
    assert read(servo, "hardware_error_status") == expected


def test_bus_watchdog_stops_locks_goals_and_is_cleared_by_zero(servo, read, write):
    write(servo, "operating_mode", 4)
    write(servo, "torque_enable", 1)
    write(servo, "bus_watchdog", 5)
    servo.step(0.09, 0.001)
    assert read(servo, "bus_watchdog", 0.09) == 5
    servo.heard(0.09)
    servo.step(0.18, 0.001)
    assert read(servo, "bus_watchdog", 0.18) == 5
    servo.step(0.25, 0.001)
    assert read(servo, "bus_watchdog", 0.25) == -1
    assert read(servo, "torque_enable", 0.25) == 1
    assert write(servo, "goal_position", 500, 0.25) == StatusError.DATA_RANGE
    assert write(servo, "bus_watchdog", 0, 0.25) == 0
    assert write(servo, "goal_position", 500, 0.25) == 0


def test_bus_watchdog_sleeps_without_torque(servo, read, write):
    write(servo, "bus_watchdog", 1)
    servo.step(10.0, 0.001)
    assert read(servo, "bus_watchdog", 10.0) == 1


def test_reg_write_and_action(servo, read, write):
    assert do(servo, Instruction.ACTION).error == StatusError.INSTRUCTION
    write(servo, "operating_mode", 4)
    assert do(servo, Instruction.REG_WRITE, bytes.fromhex("7400 39300000")).error == 0
    assert read(servo, "goal_position") != 12345
    assert read(servo, "registered_instruction") == 1
    assert do(servo, Instruction.ACTION).error == 0
    assert read(servo, "goal_position") == 12345
    assert do(servo, Instruction.ACTION).error == StatusError.INSTRUCTION


def test_factory_reset_keeps_what_it_is_told_to(servo, read, write):
    write(servo, "baud_rate", 3)
    write(servo, "return_delay_time", 0)
    assert do(servo, Instruction.FACTORY_RESET, b"\x02").error == 0
    assert (read(servo, "id"), read(servo, "baud_rate"), read(servo, "return_delay_time")) == (7, 3, 250)
    assert do(servo, Instruction.FACTORY_RESET, b"\xff").error == 0
    assert (read(servo, "id"), read(servo, "baud_rate")) == (1, 1)


def test_backup_and_restore(servo, read, write):
    key = bytes.fromhex("4354524C")
    write(servo, "return_delay_time", 11)
    assert do(servo, Instruction.CONTROL_TABLE_BACKUP, b"\x01" + key).error == 0
    write(servo, "return_delay_time", 99)
    assert do(servo, Instruction.CONTROL_TABLE_BACKUP, b"\x02" + key).error == 0
    assert read(servo, "return_delay_time") == 11
    write(servo, "torque_enable", 1)
    assert do(servo, Instruction.CONTROL_TABLE_BACKUP, b"\x01" + key).error == StatusError.RESULT_FAIL
    assert do(servo, Instruction.CONTROL_TABLE_BACKUP, b"\x03" + key).error == StatusError.DATA_RANGE


def test_indirect_addresses_read_and_write_elsewhere(servo, read, write):
    block = servo.model.indirect[0]
    for index, address in enumerate((116, 117, 118, 119, 146)):
        place = block.addresses + 2 * index
        assert servo.write_for_host(place, address.to_bytes(2, "little"), 0.0).error == 0
    write(servo, "operating_mode", 4)
    assert servo.write_for_host(block.data, (-9).to_bytes(4, "little", signed=True), 0.0).error == 0
    assert read(servo, "goal_position") == -9
    servo.shaft.temperature_c = 33.0
    assert servo.read_for_host(block.data + 4, 1, 0.0).parameters == bytes([33])
    assert servo.write_for_host(block.data + 4, b"\x01", 0.0).error == StatusError.ACCESS


def test_position_glitch_shows_and_goes(servo, read, write):
    write(servo, "operating_mode", 4)
    servo.position_glitch_pulses = -4095
    assert read(servo, "present_position") == -4095
    servo.position_glitch_pulses = 0
    assert read(servo, "present_position") == 0


def test_a_profile_reaches_its_goal_in_the_time_the_trapezoid_takes(write):
    servo = EmulatedServo(load_model("xl330_m288"), 1)
    write(servo, "operating_mode", 4)
    write(servo, "profile_velocity", 100)
    write(servo, "profile_acceleration", 20)
    write(servo, "torque_enable", 1)
    write(servo, "goal_position", 4096)
    steps = 0
    while servo.motion.position != 4096.0 and steps < 10_000:
        steps += 1
        servo.step(steps * 1e-3, 1e-3)
    speed = 100 * 0.229 / 60  # rev/s
    acceleration = 20 * 214.577 / 3600  # rev/s^2
    assert steps * 1e-3 == pytest.approx(1.0 / speed + speed / acceleration, rel=0.02)


def test_servos_come_with_their_makers_settings():
    """e-manual, items 7 and 8; Feetech, memory table, items 5 and 6; a Damiao motor's is set with the maker's tool."""
    assert factory_settings("XL330-M288") == (1, 57_600)
    assert factory_settings("STS3215") == (1, 1_000_000)
    with pytest.raises(EmulatorError, match="expected servos that get their IDs over the bus"):
        factory_settings("DM-J4310-2EC")
