# SPDX-License-Identifier: Apache-2.0
"""Packets against the e-manual's own examples (those whose CRC is right) and against any noise."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_emulator.dynamixel.packets import (
    BROADCAST_ID,
    HEADER,
    Instruction,
    PacketReader,
    crc16,
    encode,
    encode_fast_status,
    encode_status,
    stuff,
    unstuff,
)

HEAD = bytes.fromhex("FF FF FD 00")


def test_crc_is_the_catalogued_one():
    assert crc16(b"123456789") == 0xFEE8


@pytest.mark.parametrize(
    ("packet", "expected"),
    [
        (encode(1, Instruction.PING), "01 03 00 01 19 4E"),
        (encode(1, Instruction.READ, bytes.fromhex("84000400")), "01 07 00 02 84 00 04 00 1D 15"),
        (encode(1, Instruction.WRITE, bytes.fromhex("740000020000")), "01 09 00 03 74 00 00 02 00 00 CA 89"),
        (encode(1, Instruction.REBOOT), "01 03 00 08 2F 4E"),
        (encode(1, Instruction.CLEAR, bytes.fromhex("0144584C22")), "01 08 00 10 01 44 58 4C 22 B1 DC"),
        (
            encode(BROADCAST_ID, Instruction.SYNC_READ, bytes.fromhex("840004000102")),
            "FE 09 00 82 84 00 04 00 01 02 CE FA",
        ),
        (
            encode(BROADCAST_ID, Instruction.SYNC_WRITE, bytes.fromhex("74000400 0196000000 02AA000000")),
            "FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
        ),
        (
            encode(BROADCAST_ID, Instruction.BULK_READ, bytes.fromhex("0190000200 0292000100")),
            "FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
        ),
        (
            encode(BROADCAST_ID, Instruction.FAST_SYNC_READ, bytes.fromhex("84000400030704")),
            "FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
        ),
        (encode_status(1, 0, bytes.fromhex("060426")), "01 07 00 55 00 06 04 26 65 5D"),
        (encode_status(1, 0, bytes.fromhex("A6000000")), "01 08 00 55 00 A6 00 00 00 8C C0"),
        (encode_status(1, 0), "01 04 00 55 00 A1 0C"),
    ],
)
def test_golden_packets(packet, expected):
    assert packet == HEAD + bytes.fromhex(expected)


def test_golden_fast_sync_read_status():
    parts = [(0, 3, bytes.fromhex("A6000000")), (0, 7, bytes.fromhex("1F080000")), (0, 4, bytes.fromhex("FF030000"))]
    expected = "FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    assert b"".join(encode_fast_status(parts)) == HEAD + bytes.fromhex(expected)


@pytest.mark.parametrize("position", [-1, -131073, -131072, -65537, -12386304, 0x00FDFFFF, -(1 << 20) + 1])
def test_real_multi_turn_positions_survive_stuffing(position):
    parameters = bytes.fromhex("7400") + (position & 0xFFFFFFFF).to_bytes(4, "little")
    packet = encode(1, Instruction.WRITE, parameters)
    assert HEADER not in packet[4:]
    (back,) = PacketReader().feed(packet)
    assert (back.parameters, back.crc_ok) == (parameters, True)


def test_a_position_whose_bytes_are_a_header_is_stuffed():
    # -131073 is FF FF FD FF, and 16,646,143 is FF FF FD 00: a whole header.
    packet = encode(1, Instruction.WRITE, bytes.fromhex("7400 FFFFFD00"))
    assert packet[10:15] == bytes.fromhex("FF FF FD FD 00")
    assert int.from_bytes(packet[5:7], "little") == 10


@given(st.binary(max_size=64))
def test_stuffing_undoes_itself(body):
    assert unstuff(stuff(body)) == body


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01]), max_size=40).map(bytes))
def test_stuffing_undoes_itself_where_it_hurts(body):
    assert unstuff(stuff(body)) == body
    assert b"\xff\xff\xfd\x00" not in stuff(body)


packets = st.builds(
    lambda i, n, p: (i, n, p),
    st.integers(0, 252),
    st.integers(1, 0x9A).filter(lambda n: n != 0xFF),
    st.binary(max_size=40),
)


@given(st.lists(packets, max_size=4), st.data())
@settings(max_examples=200)
def test_packets_come_through_however_they_are_cut(rows, data):
    stream = b"".join(encode(*row) for row in rows)
    reader, got, place = PacketReader(), [], 0
    while place < len(stream):
        step = data.draw(st.integers(1, 9))
        got += reader.feed(stream[place : place + step])
        place += step
    assert [(p.device_id, p.instruction, p.parameters) for p in got] == rows
    assert all(p.crc_ok for p in got)


@given(st.binary(max_size=30).filter(lambda noise: b"\xff" not in noise), packets)
def test_a_packet_is_found_behind_noise(noise, row):
    got = PacketReader().feed(noise + encode(*row))
    assert [(p.device_id, p.instruction, p.parameters) for p in got if p.crc_ok] == [row]


@given(packets, st.data())
def test_a_flipped_bit_is_never_taken_for_right(row, data):
    packet = bytearray(encode(*row))
    place = data.draw(st.integers(4, len(packet) - 1))
    packet[place] ^= 1 << data.draw(st.integers(0, 7))
    assert not any(p.crc_ok for p in PacketReader().feed(bytes(packet)))
