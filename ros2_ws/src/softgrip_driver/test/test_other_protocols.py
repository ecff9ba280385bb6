# SPDX-License-Identifier: Apache-2.0
"""Bytes of Feetech's and Damiao's protocols beside those that other people's programs make."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.damiao import frames, slcan
from softgrip_driver.damiao.frames import MODELS, DamiaoState, Register
from softgrip_driver.feetech import packets
from softgrip_driver.feetech import registers as reg

pytest.importorskip("scservo_sdk")
import scservo_sdk

RANGES = MODELS["DM-J4310-2EC"].ranges


@given(st.integers(0, 253), st.sampled_from([0x01, 0x02, 0x03, 0x0A]), st.binary(max_size=40))
def test_a_packet_s_checksum_is_the_maker_s(servo_id, instruction, parameters):
    packet = packets.encode(servo_id, instruction, parameters)
    sent = []

    class Port:
        is_using = False

        def clearPort(self):
            pass

        def writePort(self, data):
            sent.append(bytes(data))
            return len(data)

    maker = scservo_sdk.PacketHandler(0)
    maker.txPacket(Port(), [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0])
    assert sent == [packet]


@given(st.sampled_from([(reg.GOAL_POSITION, 15), (reg.PRESENT_LOAD, 10)]), st.integers(-1000, 1000))
def test_signs_are_the_maker_s(item_and_bit, value):
    item, bit = item_and_bit
    raw = scservo_sdk.SCS_TOSCS(value, bit)
    assert item.decode(raw.to_bytes(2, "little")) == value
    assert item.encode(value) == raw.to_bytes(2, "little")


@given(st.binary(max_size=200))
def test_any_bytes_are_answers_or_damage(heard):
    answers, damaged = packets.decode(heard)
    assert all(0 <= one.servo_id <= 254 for one in answers)
    assert damaged >= 0
    for frame in slcan.decode(heard)[0]:
        frames.feedback(frame, RANGES)


def test_an_answer_is_found_behind_noise():
    answer = packets.encode(3, 0, b"\x01\x02")
    (found,), damaged = packets.decode(b"\x00\xff" + answer + b"\xff")
    assert (found.servo_id, found.status, found.data, damaged) == (3, 0, b"\x01\x02", 0)


@pytest.mark.parametrize(
    ("frame", "can_id", "data"),
    [
        # made by damiao-motor 1.0.6, DaMiaoMotor(3, 0x13, motor_type="4310")
        (frames.enable(3), 0x003, "fffffffffffffffc"),
        (frames.disable(3), 0x003, "fffffffffffffffd"),
        (frames.clear_error(3), 0x003, "fffffffffffffffb"),
        (frames.force_position(3, -1.25, 3.5, 0.25), 0x303, "0000a0bf5e01c409"),
        (frames.read_register(3, Register.MAX_CURRENT), 0x7FF, "0300333b00000000"),
        (frames.write_register(3, Register.TIMEOUT, 2000), 0x7FF, "03005509d0070000"),
        (frames.write_register(3, Register.OVER_TEMPERATURE, 98.5), 0x7FF, "030055020000c542"),
    ],
)
def test_frames_are_those_of_damiao_motor(frame, can_id, data):
    assert (frame.can_id, frame.data.hex()) == (can_id, data)


@pytest.mark.parametrize(
    ("data", "state", "position", "speed", "torque", "board", "rotor"),
    [
        # read by damiao-motor 1.0.6
        ("138c4f7ff9991c21", DamiaoState.ENABLED, 1.2022201876859686, -0.0073260073260073, 2.0, 28.0, 33.0),
        ("d37fff80080019ff", DamiaoState.LOST_COMMUNICATION, -0.0001907377737087, 0.0073260073260073,
         0.0024420024420024, 25.0, 255.0),
    ],
)  # fmt: skip
def test_feedback_reads_as_damiao_motor_reads_it(data, state, position, speed, torque, board, rotor):
    seen = frames.feedback(slcan.Frame(0x13, bytes.fromhex(data)), RANGES)
    assert (seen.motor_id, seen.state, seen.board, seen.rotor) == (3, state, board, rotor)
    assert (seen.position, seen.speed, seen.torque) == pytest.approx((position, speed, torque), abs=1e-9)


def test_lines_of_an_adapter_are_frames_confirmations_and_damage():
    line = slcan.encode([slcan.Frame(0x13, b"\x01\x02")])
    assert line == b"t01320102\r"
    found, damaged = slcan.decode(b"z\r\r" + line + b"\at0132010\rt013")
    assert (found, damaged) == ([slcan.Frame(0x13, b"\x01\x02")], 1)
