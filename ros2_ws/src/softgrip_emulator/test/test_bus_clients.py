# SPDX-License-Identifier: Apache-2.0
"""Two independent clients drive the emulated chain: dynamixel-sdk (ROBOTIS) and rustypot (Rust)."""

import math
import time

import dynamixel_sdk
import pytest

from softgrip_emulator.dynamixel.servo import REBOOT_SILENCE_S
from softgrip_emulator.dynamixel.table import load_model

pytest.importorskip("rustypot")
import rustypot

OK = dynamixel_sdk.COMM_SUCCESS
TIMEOUT = dynamixel_sdk.COMM_RX_TIMEOUT
GOAL_POSITION, PRESENT_POSITION = 116, 132


def set_turns(servos, turns):
    for servo, value in zip(servos, turns, strict=True):
        servo.shaft.angle_rad = value * 2 * math.pi


def multi_turn(sdk):
    port, packets = sdk
    for number in (1, 2, 3):
        assert packets.write1ByteTxRx(port, number, 11, 4) == (OK, 0)


def signed(value, bits=32):
    return value - (1 << bits) if value >> (bits - 1) else value


def test_ping_and_broadcast_ping(sdk):
    port, packets = sdk
    assert packets.ping(port, 2) == (1200, OK, 0)
    assert packets.ping(port, 9)[1] == TIMEOUT
    found, result = packets.broadcastPing(port)
    assert result == OK
    assert found == {1: [1200, 52], 2: [1200, 52], 3: [1200, 52]}


@pytest.mark.parametrize("position", [0, 4095, -1, -131073, -65537, 1_048_575, -1_048_575])
def test_write_and_read_back_with_stuffing(sdk, position):
    multi_turn(sdk)
    port, packets = sdk
    assert packets.write4ByteTxRx(port, 1, GOAL_POSITION, position & 0xFFFFFFFF) == (OK, 0)
    value, result, error = packets.read4ByteTxRx(port, 1, GOAL_POSITION)
    assert (signed(value), result, error) == (position, OK, 0)


def test_the_largest_velocity_limit_of_the_e_manual_is_taken(sdk):
    """Item 44 of xl330-m288: 0 to 2047."""
    port, packets = sdk
    assert packets.write4ByteTxRx(port, 1, 44, 2047) == (OK, 0)
    assert packets.read4ByteTxRx(port, 1, 44) == (2047, OK, 0)
    assert packets.write4ByteTxRx(port, 1, 44, 2048) == (OK, 4)


def test_errors_of_the_device_reach_the_client(sdk):
    port, packets = sdk
    assert packets.write4ByteTxRx(port, 1, GOAL_POSITION, 5000) == (OK, 6)
    assert packets.write1ByteTxRx(port, 1, 9, 255) == (OK, 4)
    assert packets.write2ByteTxRx(port, 1, 0, 1) == (OK, 7)
    assert packets.write1ByteTxRx(port, 1, 64, 1) == (OK, 0)
    assert packets.write1ByteTxRx(port, 1, 11, 4) == (OK, 7)


@pytest.mark.parametrize("fast", [False, True])
def test_sync_read(sdk, servos, fast):
    multi_turn(sdk)
    set_turns(servos, (1.0, -32.0, 2.5))
    port, packets = sdk
    group = dynamixel_sdk.GroupSyncRead(port, packets, 126, 10)
    for number in (1, 2, 3):
        assert group.addParam(number)
    assert (group.fastSyncRead() if fast else group.txRxPacket()) == OK
    positions = [signed(group.getData(number, PRESENT_POSITION, 4)) for number in (1, 2, 3)]
    # -32 turns are -131072 pulses: bytes 00 00 FE FF
    assert positions == [4096, -131072, 10240]


def test_sync_write_bulk_read_and_bulk_write(sdk, servos):
    multi_turn(sdk)
    port, packets = sdk
    sync = dynamixel_sdk.GroupSyncWrite(port, packets, GOAL_POSITION, 4)
    for number in (1, 2, 3):
        assert sync.addParam(number, list((-131073 * number & 0xFFFFFFFF).to_bytes(4, "little")))
    assert sync.txPacket() == OK
    bulk = dynamixel_sdk.GroupBulkWrite(port, packets)
    assert bulk.addParam(2, 65, 1, [1])
    assert bulk.addParam(3, 102, 2, [0x2C, 0x01])
    assert bulk.txPacket() == OK
    reader = dynamixel_sdk.GroupBulkRead(port, packets)
    reader.addParam(1, GOAL_POSITION, 4)
    reader.addParam(2, 65, 1)
    reader.addParam(3, 102, 2)
    assert reader.txRxPacket() == OK
    assert signed(reader.getData(1, GOAL_POSITION, 4)) == -131073
    assert reader.getData(2, 65, 1) == 1
    assert reader.getData(3, 102, 2) == 300
    assert reader.fastBulkRead() == OK
    assert reader.getData(3, 102, 2) == 300


def test_a_silent_servo_fails_the_group_and_not_the_others(sdk, servos):
    port, packets = sdk
    servos[1].silenced = True
    group = dynamixel_sdk.GroupSyncRead(port, packets, PRESENT_POSITION, 4)
    for number in (1, 2, 3):
        group.addParam(number)
    assert group.txRxPacket() == TIMEOUT
    assert group.fastSyncRead() != OK
    assert packets.ping(port, 3)[1] == OK


def test_behind_a_silent_servo_nobody_answers_a_sync_read(sdk, servos):
    """ROBOTIS-GIT/DynamixelSDK issue 364: "if one device does not respond in the middle, all IDs do not respond"."""
    port, packets = sdk
    for silent, answering in ((2, [1]), (1, []), (3, [1, 2])):
        for servo in servos:
            servo.silenced = servo.device_id == silent
        packets.syncReadTx(port, PRESENT_POSITION, 4, [1, 2, 3], 3, False)
        time.sleep(0.1)  # longer than all three take
        port.is_using = False
        answers = bytes(port.readPort(200)).split(b"\xff\xff\xfd\x00")[1:]
        assert [answer[0] for answer in answers] == answering


def test_an_alert_marks_every_reply_and_leaves_the_data_valid(sdk, servos):
    port, packets = sdk
    servos[0].forced_error_bits = 0x20
    servos[0].step(0.0, 0.001)
    assert packets.read1ByteTxRx(port, 1, 70) == (0x20, OK, 128)
    assert packets.read1ByteTxRx(port, 2, 70) == (0, OK, 0)


def test_reboot_silence(sdk, until):
    port, packets = sdk
    assert packets.reboot(port, 1) == (OK, 0)
    assert packets.ping(port, 1)[1] == TIMEOUT
    assert packets.ping(port, 2)[1] == OK
    assert until(lambda: packets.ping(port, 1)[1] == OK, REBOOT_SILENCE_S + 2.0)


def test_a_servo_at_another_baud_is_not_heard(sdk):
    port, packets = sdk
    assert packets.write1ByteTxRx(port, 1, 8, 1) == (OK, 0)
    assert packets.ping(port, 1)[1] == TIMEOUT
    assert port.setBaudRate(57_600)
    assert packets.ping(port, 1)[1] == OK
    assert packets.ping(port, 2)[1] == TIMEOUT


def test_status_return_level(sdk):
    port, packets = sdk
    assert packets.write1ByteTxRx(port, 1, 68, 1) == (OK, 0)
    assert packets.write1ByteTxRx(port, 1, 65, 1)[0] == TIMEOUT
    assert packets.read1ByteTxRx(port, 1, 65) == (1, OK, 0)
    assert packets.write1ByteTxRx(port, 1, 68, 0)[0] == TIMEOUT
    assert packets.read1ByteTxRx(port, 1, 65)[1] == TIMEOUT
    assert packets.ping(port, 1)[1] == OK


def test_changing_the_id_answers_under_the_old_one(sdk):
    port, packets = sdk
    assert packets.write1ByteTxRx(port, 3, 7, 42) == (OK, 0)
    assert packets.ping(port, 42)[1] == OK
    assert packets.ping(port, 3)[1] == TIMEOUT


def test_a_secondary_id_is_obeyed_and_never_answered(sdk, servos):
    """The example of the e-manual, "Secondary ID(12)"; the group writes are an assumption."""
    port, packets = sdk

    def leds():
        return [servo.registers.get("led") for servo in servos]

    for number in (1, 2, 3):
        assert packets.write1ByteTxRx(port, number, 12, 3) == (OK, 0)
    assert packets.write1ByteTxRx(port, 3, 65, 1) == (OK, 0), "one answer, that of the servo whose own ID it is"
    assert leds() == [1, 1, 1]
    for number in (1, 2, 3):
        assert packets.write1ByteTxRx(port, number, 12, 100) == (OK, 0)
    assert packets.write1ByteTxRx(port, 100, 65, 0)[0] == TIMEOUT
    assert leds() == [0, 0, 0]
    assert packets.ping(port, 100)[1] == TIMEOUT
    assert packets.write1ByteTxRx(port, 100, 9, 7)[0] == TIMEOUT
    assert [servo.registers.get("return_delay_time") for servo in servos] == [0, 0, 0], "the EEPROM is closed to it"
    group = dynamixel_sdk.GroupSyncWrite(port, packets, 65, 1)
    group.addParam(100, [1])
    group.txPacket()
    assert packets.read1ByteTxRx(port, 2, 65) == (1, OK, 0)
    assert packets.write1ByteTxRx(port, 2, 12, 255) == (OK, 0)
    assert packets.write1ByteTxRx(port, 100, 65, 0)[0] == TIMEOUT
    assert leds() == [0, 1, 0]


def test_reg_write_and_broadcast_action(sdk):
    multi_turn(sdk)
    port, packets = sdk
    for number in (1, 2):
        assert packets.regWriteTxRx(port, number, GOAL_POSITION, 4, [1, 2, 0, 0]) == (OK, 0)
    assert packets.action(port, dynamixel_sdk.BROADCAST_ID) == OK
    assert packets.read4ByteTxRx(port, 2, GOAL_POSITION) == (0x201, OK, 0)


def test_rustypot_pings_reads_and_writes(bus, servos):
    set_turns(servos, (0.25, 0.5, 0.75))
    client = rustypot.Xl330PyController(str(bus.link), 1_000_000, 0.2)
    assert client.ping(1)
    assert not client.ping(200)
    # rustypot counts radians from the middle of the turn
    expected = [-math.pi / 2, 0.0, math.pi / 2]
    assert client.sync_read_present_position([1, 2, 3]) == pytest.approx(expected, abs=0.002)
    client.write_torque_enable(2, True)
    assert client.read_torque_enable(2) == [True]
    client.sync_write_goal_position([1, 2, 3], [0.0, 0.5, -0.5])
    assert client.read_goal_position(3) == pytest.approx([-0.5], abs=0.002)
    assert servos[1].registers.get("goal_position") == pytest.approx(2048 + 0.5 * 4096 / (2 * math.pi), abs=1)


#: model, firmware, registers where rustypot has them, and what it has beyond ROBOTIS' table of today
RUSTYPOT_TABLES = [
    ("XL330-M288", 53, 68, {"acceleration_limit"}),
    ("XC330-T288", 53, 68, {"acceleration_limit"}),
    ("XL430-W250", None, 63, {"current_limit", "goal_current"}),
    ("XC430-W150", None, 63, {"current_limit", "goal_current"}),
    ("XM430-W350", None, 65, set()),
    ("XM540-W270", None, 65, set()),
]


@pytest.mark.parametrize(
    ("name", "firmware", "same", "beyond"), RUSTYPOT_TABLES, ids=[row[0] for row in RUSTYPOT_TABLES]
)
def test_rustypot_s_table_is_the_emulated_one(name, firmware, same, beyond):
    """Model number, and every register's address and size; the block of indirect data, too."""
    model = load_model(name) if firmware is None else load_model(name, firmware)
    number, definition = rustypot.find_model(name)
    sizes = {item.address: item.size for item in model.items}
    for block in model.indirect:
        sizes |= dict.fromkeys(range(block.data, block.data + block.count), 1)
    found = [one for one in definition.registers() if sizes.get(one.addr) == one.size]
    assert number == model.number
    assert {one.name for one in definition.registers()} - {one.name for one in found} == beyond
    assert len(found) == same
