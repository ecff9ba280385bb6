# SPDX-License-Identifier: Apache-2.0
"""Two clients that nobody here wrote drive emulated STS servos: rustypot (Rust) and feetech-servo-sdk (the maker's)."""

import math

import pytest

from softgrip_emulator.feetech.chain import FeetechChain
from softgrip_emulator.feetech.memory import load_model
from softgrip_emulator.feetech.servo import EmulatedFeetechServo
from softgrip_emulator.wire.pty import PtyPort

pytest.importorskip("rustypot")
pytest.importorskip("scservo_sdk")
import rustypot
import scservo_sdk

OK, TIMEOUT = scservo_sdk.COMM_SUCCESS, scservo_sdk.COMM_RX_TIMEOUT
IDS = (1, 2, 3)


@pytest.fixture
def servos():
    return [EmulatedFeetechServo(load_model("STS3215"), number) for number in IDS]


@pytest.fixture
def wire(servos, tmp_path):
    port = PtyPort(tmp_path / "servos", FeetechChain(servos)).start()
    yield str(tmp_path / "servos")
    port.close()


@pytest.fixture
def rust(wire):
    controller = rustypot.Sts3215PyController(wire, 1_000_000, 0.5)
    yield controller
    controller.close()


@pytest.fixture
def maker(wire, monkeypatch):
    # A busy machine answers later than a servo.
    monkeypatch.setattr(scservo_sdk.port_handler, "LATENCY_TIMER", 500)
    port = scservo_sdk.PortHandler(wire)
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    yield port, scservo_sdk.PacketHandler(0)
    port.closePort()


def test_rustypot_s_table_is_the_emulated_one(rust):
    """Every register that rustypot names reads, and at the address where the emulator has it."""
    items = {item.address: item for item in load_model("STS3215").items}
    compared = [one for one in rust.registers() if one.addr in items]
    assert len({one.addr for one in compared}) >= 40
    # rustypot has the minimum startup force as two bytes, Feetech the integral limit in the second.
    assert [one.name for one in compared if one.size != items[one.addr].size and one.addr != 24] == []
    for one in compared:
        assert (one.access == rustypot.RegisterAccess.Read) != items[one.addr].writable, one.name


@pytest.mark.parametrize(("steps", "angle"), [(0, -math.pi), (2048, 0.0), (4095, math.pi * 2047 / 2048)])
def test_rustypot_reads_a_position_as_an_angle(rust, servos, steps, angle):
    servos[1].shaft.angle_rad = steps * 2.0 * math.pi / 4096
    servos[1].fold()
    (found,) = rust.read_present_position(2)
    assert found == pytest.approx(angle, abs=1e-3)


def test_rustypot_writes_a_goal_and_reads_what_is_measured(rust, servos):
    rust.write_torque_enable(1, True)
    rust.write_goal_position(1, 0.5)
    assert servos[0].registers.get("goal_position") == pytest.approx(2048 + 0.5 * 4096 / (2.0 * math.pi), abs=1)
    assert servos[0].registers.get("torque_enable") == 1
    servos[0].shaft.supply_v, servos[0].shaft.temperature_c = 7.3, 41.0
    assert rust.read_present_voltage(1) == [73]
    assert rust.read_present_temperature(1) == [41]
    assert rust.sync_read_present_temperature([1, 2, 3])[0] == 41
    assert rust.read_model_number(1) == [777]


def test_the_maker_s_sdk_pings_reads_and_writes(maker, servos):
    port, packets = maker
    assert packets.ping(port, 2) == (777, OK, 0)
    assert packets.ping(port, 9)[1] == TIMEOUT
    for address, size, name in ((9, 2, "min_angle_limit"), (13, 1, "max_temperature_limit"), (16, 2, "max_torque"),
                                (18, 1, "phase"), (33, 1, "operating_mode"), (48, 2, "torque_limit")):  # fmt: skip
        read = packets.read2ByteTxRx if size == 2 else packets.read1ByteTxRx
        assert read(port, 1, address) == (servos[0].registers.get(name), OK, 0)
    assert packets.write2ByteTxRx(port, 1, 48, 321) == (OK, 0)
    assert servos[0].registers.get("torque_limit") == 321


@pytest.mark.parametrize("steps", [0, 4095, -1, -30719, 30719])
def test_the_maker_s_sdk_and_the_emulator_agree_on_signs(maker, servos, steps):
    port, packets = maker
    for address, size, value in ((9, 2, 0), (11, 2, 0), (18, 1, 12 | 16)):
        write = packets.write2ByteTxRx if size == 2 else packets.write1ByteTxRx
        assert write(port, 1, address, value) == (OK, 0)
    servos[0].shaft.angle_rad = steps * 2.0 * math.pi / 4096
    servos[0]._fold_steps = 0
    value, result, error = packets.read2ByteTxRx(port, 1, 56)
    assert (scservo_sdk.SCS_TOHOST(value, 15), result, error) == (steps, OK, 0)
    assert packets.write2ByteTxRx(port, 1, 42, scservo_sdk.SCS_TOSCS(steps, 15)) == (OK, 0)
    servos[0].step(10.0, 30.0)
    assert servos[0]._setpoint == pytest.approx(steps, abs=0.6)


@pytest.mark.parametrize("offset", [-2047, -1, 0, 500, 2047])
def test_a_homing_offset_is_taken_from_what_it_reads(maker, servos, offset):
    """As LeRobot has it (feetech.py): present is actual less offset, eleven bits and a sign; a goal is in the same."""
    port, packets = maker
    servos[0].shaft.angle_rad = 1000 * 2.0 * math.pi / 4096
    assert packets.write2ByteTxRx(port, 1, 31, scservo_sdk.SCS_TOSCS(offset, 11)) == (OK, 0)
    value, result, error = packets.read2ByteTxRx(port, 1, 56)
    assert (scservo_sdk.SCS_TOHOST(value, 15), result, error) == ((1000 - offset) % 4096, OK, 0)


def test_the_maker_s_sdk_reads_and_writes_groups(maker, servos):
    port, packets = maker
    group = scservo_sdk.GroupSyncWrite(port, packets, 42, 2)
    for number in IDS:
        assert group.addParam(number, [number, 1])
    assert group.txPacket() == OK
    read = scservo_sdk.GroupSyncRead(port, packets, 42, 2)
    for number in IDS:
        assert read.addParam(number)
    assert read.txRxPacket() == OK
    assert [read.getData(number, 42, 2) for number in IDS] == [256 + number for number in IDS]
    assert [servo.registers.get("torque_enable") for servo in servos] == [1, 1, 1]


def test_an_eprom_write_lasts_only_where_it_was_unlocked(maker, servos):
    port, packets = maker
    assert packets.write1ByteTxRx(port, 1, 13, 60) == (OK, 0)
    servos[0].lose_power(0.0)
    assert servos[0].registers.get("max_temperature_limit") == 70
    assert packets.write1ByteTxRx(port, 2, 55, 0) == (OK, 0)
    assert packets.write1ByteTxRx(port, 2, 13, 60) == (OK, 0)
    servos[1].lose_power(0.0)
    assert servos[1].registers.get("max_temperature_limit") == 60


def test_an_error_is_in_every_answer(maker, servos):
    servos[0].forced_error_bits = 4
    servos[0].step(0.0, 0.001)
    port, packets = maker
    assert packets.read1ByteTxRx(port, 1, 40)[1:] == (OK, 4)
