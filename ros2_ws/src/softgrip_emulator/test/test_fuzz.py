# SPDX-License-Identifier: Apache-2.0
"""Noise on the device's side of the bus: 100,000 random and mutated byte streams; nothing wrong is obeyed."""

import os
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.packets import BROADCAST_ID, Instruction, PacketReader, encode
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_testing.emulator_fuzz import holds_packet, mutate

STREAMS = 100_000
#: lists of pieces that hypothesis makes up; `make fuzz` asks for 100,000
EXAMPLES = int(os.environ.get("SOFTGRIP_FUZZ_EXAMPLES", "300"))
KEEPERS = ("id", "baud_rate", "goal_position", "operating_mode", "torque_enable", "profile_velocity")
#: address, size and largest value of items that a host writes: packets that a servo obeys
WRITTEN = ((64, 1, 1), (112, 4, 32767), (116, 4, 4095))


def make_chain():
    model = load_model("xl330_m288")
    return DynamixelChain([EmulatedServo(model, number, baud=57_600) for number in (1, 2, 3)])


def values(chain):
    return [tuple(servo.registers.get(name) for name in KEEPERS) for servo in chain.servos]


def good_packets(rng):
    """One well-formed packet, of those a host sends."""
    choice = rng.randrange(6)
    device = rng.choice((1, 2, 3, 9, BROADCAST_ID))
    if choice == 0:
        return encode(device, Instruction.PING)
    if choice == 1:
        return encode(device, Instruction.READ, bytes([rng.randrange(256), 0, rng.randrange(16), 0]))
    if choice == 2:
        address, size, maximum = rng.choice(WRITTEN)
        return encode(
            device, Instruction.WRITE, bytes([address, 0]) + rng.randrange(maximum + 1).to_bytes(size, "little")
        )
    if choice == 3:
        return encode(BROADCAST_ID, Instruction.SYNC_READ, bytes([132, 0, 4, 0, 1, 2, 3]))
    if choice == 4:
        goals = [bytes([number]) + rng.randrange(4096).to_bytes(4, "little") for number in (1, 2)]
        return encode(BROADCAST_ID, Instruction.SYNC_WRITE, bytes([116, 0, 4, 0]) + b"".join(goals))
    return encode(BROADCAST_ID, Instruction.FAST_SYNC_READ, bytes([126, 0, 10, 0, 3, 1]))


def test_what_is_mutated_would_be_obeyed():
    """Else the noise below could not do any harm, whatever the servos did with it."""
    rng, chain, obeyed = random.Random(3), make_chain(), 0
    for number in range(300):
        before = values(chain)
        chain.exchange(good_packets(rng), float(number), 57_600)
        obeyed += values(chain) != before
    assert obeyed > 60


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_mutated_streams_neither_raise_nor_change_a_register():
    rng = random.Random(20261121)
    chain = make_chain()
    before = values(chain)
    obeyed = 0
    for number in range(STREAMS):
        kind = rng.randrange(3)
        stream = rng.randbytes(rng.randrange(1, 40)) if kind == 0 else mutate(good_packets(rng), rng)
        # Each stream comes after a pause that ends a packet begun before.
        chain.exchange(stream, float(number), 57_600)
        after = values(chain)
        if after != before:
            obeyed += 1
            assert holds_packet(stream), stream.hex(" ")
            before = after
    # Some mutations cancel out, or stand before or behind a packet that stays whole.
    assert obeyed < STREAMS // 20


@given(st.lists(st.binary(max_size=60), max_size=8), st.sampled_from([9600, 57_600, 1_000_000]))
@settings(max_examples=EXAMPLES, deadline=None)
def test_any_bytes_in_any_pieces(pieces, baud):
    chain = make_chain()
    for number, piece in enumerate(pieces):
        for chunk in chain.exchange(piece, 0.001 * number, baud):
            assert chunk.start_s >= 0.001 * number
            assert len(chunk.data) >= 11


def test_a_group_read_longer_than_any_packet_is_not_answered():
    asked = encode(BROADCAST_ID, Instruction.FAST_SYNC_READ, bytes.fromhex("0000 0080 00 01"))
    assert make_chain().exchange(asked, 0.0, 57_600) == []


@pytest.mark.parametrize("instruction", [Instruction.SYNC_READ, Instruction.FAST_SYNC_READ])
def test_a_group_read_that_names_a_servo_twice_is_not_answered(instruction):
    def answers(*ids):
        return make_chain().exchange(encode(BROADCAST_ID, instruction, bytes([132, 0, 4, 0, *ids])), 0.0, 57_600)

    assert answers(1, 2)
    assert answers(1, 2, 1) == []


# every instruction byte with any parameters, CRC right: what a confused host sends
@given(st.sampled_from([1, 2, BROADCAST_ID, 0xFD, 0xFF]), st.integers(0, 255), st.binary(max_size=30))
@settings(max_examples=1500, deadline=None)
def test_any_instruction_with_any_parameters(device, instruction, parameters):
    chain = make_chain()
    replies = b"".join(chunk.data for chunk in chain.exchange(encode(device, instruction, parameters), 0.0, 57_600))
    for reply in PacketReader().feed(replies):
        assert reply.crc_ok or instruction in {Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ}
        assert reply.instruction == Instruction.STATUS


def test_the_chain_still_answers_after_noise():
    rng = random.Random(5)
    chain = make_chain()
    for number in range(2000):
        chain.exchange(rng.randbytes(rng.randrange(1, 200)), float(number), 57_600)
    for servo in chain.servos:
        servo.registers.put("status_return_level", 2)
    (reply,) = chain.exchange(encode(1, Instruction.PING), 1e6, 57_600)
    assert reply.data.startswith(bytes.fromhex("FFFFFD000107005500B004"))


def test_a_packet_is_known_in_noise():
    packet = encode(1, Instruction.PING)
    assert holds_packet(b"noise" + packet + b"noise")
    assert not holds_packet(packet[:-1])
    assert not holds_packet(packet[:-1] + b"\x00")


@pytest.mark.parametrize(
    ("model", "behind"),
    # behind the last indirect data (e-manual: XL330 Indirect Data 20 at 227, XM430 Indirect Data 56 at 661)
    [("xl330_m288", 228), ("xc330_m288", 228), ("xm430_w350", 662)],
)
def test_a_table_ends_where_the_manual_ends_it(model, behind):
    assert load_model(model).size == behind
