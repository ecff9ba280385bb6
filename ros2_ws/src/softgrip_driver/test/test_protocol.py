# SPDX-License-Identifier: Apache-2.0
"""What goes over the wire: golden packets, stuffing, and streams that are wrong in every way."""

import contextlib
import os
import random
import re
import tty

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import example, given, settings
from hypothesis import strategies as st

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bus import Bus, BusReply
from softgrip_driver.dynamixel.stuffing import PacketHandler, stuff, unstuff
from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, DriverError, NoReplyError, PortLostError
from softgrip_testing.driver_fuzz import SEEDS, DriverFuzzTarget, ScriptedSerial, crc16, mutate

#: streams that hypothesis makes up; `make fuzz` asks for 100,000
EXAMPLES = int(os.environ.get("SOFTGRIP_FUZZ_EXAMPLES", "300"))
#: what a receiver would take for the beginning of a packet
FALSE_HEADER = re.compile(rb"\xff\xff\xfd(?!\xfd)")
HEADER = bytes.fromhex("ff ff fd 00")


def packet(servo_id, instruction, body):
    data = HEADER + bytes((servo_id,)) + (len(body) + 3).to_bytes(2, "little") + bytes((instruction,)) + bytes(body)
    return data + crc16(data).to_bytes(2, "little")


def status(servo_id, data, error=0):
    return packet(servo_id, 0x55, bytes((error, *data)))


@pytest.fixture
def scripted():
    """Make a bus whose device answers from a script."""
    serials = []

    def make(*replies, margin=0.002):
        bus = Bus("scripted", 1_000_000, margin)
        bus.port.ser = ScriptedSerial(replies)
        bus.port.is_open = True
        bus.port.tx_time_per_byte = 0.01
        serials.append(bus.port.ser)
        return bus, bus.port.ser

    yield make
    for one in serials:
        one.close()


def test_the_test_s_own_crc_has_the_published_check_value():
    assert crc16(b"123456789") == 0xFEE8


@pytest.mark.parametrize(
    ("act", "golden"),
    [
        (lambda bus: bus.ping(1), "ff ff fd 00 01 03 00 01 19 4e"),
        (lambda bus: bus.read_bytes(1, 132, 4), "ff ff fd 00 01 07 00 02 84 00 04 00 1d 15"),
        (lambda bus: bus.write(1, reg.GOAL_POSITION, 512), "ff ff fd 00 01 09 00 03 74 00 00 02 00 00 ca 89"),
        (lambda bus: bus.reboot(1), "ff ff fd 00 01 03 00 08 2f 4e"),
        (lambda bus: bus.sync_read([1, 2], 132, 4), "ff ff fd 00 fe 09 00 82 84 00 04 00 01 02 ce fa"),
        (lambda bus: bus.fast_sync_read([3, 7, 4], 132, 4), "ff ff fd 00 fe 0a 00 8a 84 00 04 00 03 07 04 20 f2"),
        (
            lambda bus: bus.sync_write(reg.GOAL_POSITION, {1: 150, 2: 170}),
            "ff ff fd 00 fe 11 00 83 74 00 04 00 01 96 00 00 00 02 aa 00 00 00 82 87",
        ),
    ],
)
def test_golden_instructions(scripted, act, golden):
    bus, serial = scripted()
    with contextlib.suppress(NoReplyError):
        act(bus)
    assert serial.sent == [bytes.fromhex(golden)]


def test_golden_replies(scripted):
    bus, _ = scripted(
        bytes.fromhex("ff ff fd 00 01 07 00 55 00 06 04 26 65 5d"),
        bytes.fromhex("ff ff fd 00 01 08 00 55 00 a6 00 00 00 8c c0"),
        bytes.fromhex("ff ff fd 00 01 04 00 55 00 a1 0c"),
        bytes.fromhex(
            "ff ff fd 00 fe 19 00 55 00 03 a6 00 00 00 84 08 00 07 1f 08 00 00 16 ca 00 04 ff 03 00 00 d1 9e"
        ),
    )
    assert bus.ping(1) == (0x0406, 0x26)
    assert bus.read(1, reg.PRESENT_POSITION) == 166
    bus.write(1, reg.TORQUE_ENABLE, 1)
    replies = bus.fast_sync_read([3, 7, 4], 132, 4)
    values = {servo_id: int.from_bytes(reply.data, "little") for servo_id, reply in replies.items()}
    assert values == {3: 166, 7: 2079, 4: 1023}


def test_a_common_answer_of_other_servos_is_not_taken(scripted):
    """Whole and with a right CRC, but to a question to others; a servo's values must never pass for another's."""
    late = bytes.fromhex(
        "ff ff fd 00 fe 19 00 55 00 03 a6 00 00 00 84 08 00 07 1f 08 00 00 16 ca 00 04 ff 03 00 00 d1 9e"
    )
    bus, _ = scripted(late)
    assert bus.fast_sync_read([3, 4, 7], 132, 4) == {}
    assert bus.counters.corrupt == 1


@pytest.mark.parametrize("position", [-131073, -131074, -196609, 0x00FDFFFF, 0x0003FDFF, -1, -515])
def test_real_multi_turn_positions_are_stuffed_on_the_wire(scripted, position):
    bus, serial = scripted(status(1, b""))
    bus.write(1, reg.GOAL_POSITION, position)
    (sent,) = serial.sent
    assert not FALSE_HEADER.search(sent[4:-2])
    assert int.from_bytes(sent[5:7], "little") + 7 == len(sent)
    assert crc16(sent[:-2]).to_bytes(2, "little") == sent[-2:]
    body = bytes(unstuff(sent[7:-2]))
    assert int.from_bytes(body[3:7], "little", signed=True) == position


def test_the_sdk_alone_would_send_a_false_header():
    """The reason for stuffing.py; when this fails the SDK has been repaired and the file can go."""

    class Port:
        is_using = False

        def clearPort(self):
            pass

        def writePort(self, data):
            self.sent = bytes(data)
            return len(data)

    port = Port()
    body = [0, 0, 0, 0, 1, 9, 0, 3, 116, 0, *(-131073).to_bytes(4, "little", signed=True), 0, 0]
    Protocol2PacketHandler().txPacket(port, body)
    assert b"\xff\xff\xfd\xff" in port.sent[4:]


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=40))
@example([0xFF, 0xFF, 0xFD, 0xFD])  # the last one is no stuffing
def test_stuffing_is_undone_exactly_and_leaves_no_header(body):
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    assert not FALSE_HEADER.search(bytes(stuffed))


@given(st.lists(st.integers(0, 255), min_size=1, max_size=30))
def test_any_body_survives_the_handler(body):
    data = [*HEADER, 1, len(body) + 2, 0, *body, 0, 0]
    handler = PacketHandler()
    handler.addStuffing(data)
    data[-2:] = crc16(bytes(data[:-2])).to_bytes(2, "little")
    handler.removeStuffing(data)
    assert data[7:-2] == body


def test_alert_comes_with_good_data_and_does_not_hide_it(scripted):
    bus, _ = scripted(status(1, b"\x20", error=0x80))
    reply = bus.read_bytes(1, 70, 1)
    assert reply.alert
    assert reply.data == b"\x20"


def test_a_refusal_says_what_the_servo_said(scripted):
    bus, _ = scripted(status(1, b"", error=7))
    with pytest.raises(DeviceRefusedError, match="EEPROM while torque is on") as caught:
        bus.write(1, reg.OPERATING_MODE, 5)
    assert caught.value.code == 7


def test_a_late_reply_to_another_register_is_never_taken(scripted):
    """dynamixel-sdk 4.0.3 returned a late position as the voltage."""
    late = status(1, (222).to_bytes(4, "little"))
    bus, serial = scripted(b"", status(1, (50).to_bytes(2, "little")))
    with pytest.raises(NoReplyError):
        bus.read(1, reg.PRESENT_POSITION)
    os.write(serial.writer, late)
    assert bus.read(1, reg.PRESENT_VOLTAGE) == 50


def test_a_reply_of_another_length_or_id_is_passed_over(scripted):
    good = status(1, (50).to_bytes(2, "little"))
    bus, _ = scripted(status(2, b"\x01\x02") + status(1, b"\x01\x02\x03\x04") + good)
    assert bus.read(1, reg.PRESENT_VOLTAGE) == 50


def test_a_sync_read_keeps_the_answers_that_came(scripted):
    bus, _ = scripted(status(1, b"\x01") + status(3, b"\x03", error=0x80))
    replies = bus.sync_read([1, 2, 3], 64, 1)
    assert sorted(replies) == [1, 3]
    assert replies[3].alert
    assert bus.counters.lost_by_id == {2: 1}


def test_a_sync_read_passes_over_a_late_answer_to_another_question(scripted):
    bus, _ = scripted(status(1, b"\x09\x09") + status(1, b"\x01") + status(2, b"\x02"))
    replies = bus.sync_read([1, 2], 64, 1)
    assert {servo_id: reply.data for servo_id, reply in replies.items()} == {1: b"\x01", 2: b"\x02"}


def test_noise_before_a_reply_does_no_harm(scripted):
    bus, _ = scripted(b"\xff\xff\x00\x13" + b"\xff" + status(1, b"\x07\x00"))
    assert bus.read(1, reg.PRESENT_VOLTAGE) == 7


def test_a_hundred_thousand_damaged_streams_give_an_error_or_the_truth(scripted):
    """Nothing but the driver's own errors may escape, and no value but the true one may be returned."""
    rng = random.Random(7)
    bus, serial = scripted(margin=0.0)
    bus.port.tx_time_per_byte = 0.0
    truth = (-123456).to_bytes(4, "little", signed=True)
    accepted = 0
    for _ in range(100_000):
        stream = mutate(status(1, truth), rng)
        serial.replies = [stream]
        try:
            value = bus.read_bytes(1, 132, 4).data
        except (NoReplyError, CorruptReplyError):
            continue
        except DeviceRefusedError:
            pytest.fail(f"a damaged stream passed for a refusal: {stream.hex(' ')}")
        accepted += 1
        assert value == truth, stream.hex(" ")
    assert 0 < accepted < 40_000


pieces = st.binary(max_size=40) | st.sampled_from(SEEDS) | st.builds(
    mutate, st.sampled_from(SEEDS), st.randoms(use_true_random=False)
)  # fmt: skip


@pytest.fixture(scope="module")
def target():
    return DriverFuzzTarget()


@settings(max_examples=EXAMPLES, deadline=None)
@given(stream=st.lists(pieces, max_size=4).map(b"".join))
def test_no_stream_breaks_a_parser_or_gives_a_value_that_it_does_not_hold(target, stream):
    target.feed(stream)


def test_the_fuzz_target_sees_a_wrong_value(monkeypatch):
    target = DriverFuzzTarget()
    monkeypatch.setattr(target._bus, "read_bytes", lambda *_: BusReply(1, False, 0, b"\x01\x02\x03\x04"))
    with pytest.raises(AssertionError, match="took 01 02 03 04 out of"):
        target.feed(b"noise")


def test_a_vanished_port_is_named_and_the_bus_opens_again(tmp_path):
    master, slave = os.openpty()
    tty.setraw(slave)
    link = tmp_path / "port"
    link.symlink_to(os.ttyname(slave))
    bus = Bus(str(link), 1_000_000, 0.002)
    bus.open()
    os.close(slave)
    os.close(master)
    with pytest.raises(PortLostError, match="plug the adapter in again"):
        bus.ping(1)
    assert not bus.is_open
    with pytest.raises(PortLostError):
        bus.open()
    master, slave = os.openpty()
    link.unlink()
    link.symlink_to(os.ttyname(slave))
    bus.open()
    with pytest.raises(NoReplyError):
        bus.ping(1)
    bus.close()
    os.close(master)
    os.close(slave)


def test_a_port_belongs_to_one_process_at_a_time(tmp_path):
    master, slave = os.openpty()
    first, second = (Bus(os.ttyname(slave), 1_000_000) for _ in range(2))
    first.open()
    with pytest.raises(PortLostError, match="no other program"):
        second.open()
    first.close()
    os.close(master)
    os.close(slave)


def test_a_baud_rate_the_sdk_refuses_is_named(tmp_path):
    with pytest.raises(DriverError, match="4500000"):
        Bus(str(tmp_path / "none"), 4_500_000).open()
