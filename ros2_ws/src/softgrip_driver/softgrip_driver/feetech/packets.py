# SPDX-License-Identifier: Apache-2.0
"""Packets of Feetech's SCS protocol: bytes in, values out.

FF FF ID LENGTH INSTRUCTION PARAMETERS CHECKSUM; LENGTH counts what follows it, CHECKSUM is the inverted sum from ID on
(Feetech, "Communication protocol manual"; ftservo/FTServo_Python, protocol_packet_handler.py). An answer has the
servo's status in place of the instruction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

BROADCAST = 0xFE
HEADER = b"\xff\xff"
#: a packet without parameters
OVERHEAD = 6
PING, READ, WRITE, RESET_TURNS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x0A, 0x82, 0x83
_ID_AT, _LENGTH_AT, _STATUS_AT, _DATA_AT = 2, 3, 4, 5


@dataclass(frozen=True)
class FeetechAnswer:
    """One checked answer: who, its status bits (see `registers.FeetechStatusBits`), what it said."""

    servo_id: int
    status: int
    data: bytes


def checksum(body: bytes) -> int:
    """Return the check byte of everything from ID to the last parameter."""
    return ~sum(body) & 0xFF


def encode(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a packet."""
    body = bytes([servo_id, len(parameters) + 2, instruction]) + parameters
    return HEADER + body + bytes([checksum(body)])


def encode_sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Return the packet that asks several servos for the same block; they answer in this order."""
    return encode(BROADCAST, SYNC_READ, bytes([address, size, *ids]))


def encode_sync_write(address: int, blocks: Mapping[int, bytes]) -> bytes:
    """Return the packet that gives each servo a block of its own at one address; nobody answers."""
    (size,) = {len(data) for data in blocks.values()}
    return encode(BROADCAST, SYNC_WRITE, bytes([address, size]) + b"".join(bytes([i]) + d for i, d in blocks.items()))


def decode(heard: bytes) -> tuple[list[FeetechAnswer], int]:
    """Return the answers in what was heard, and how many packets were damaged."""
    answers, damaged = [], 0
    for packet in _packets(heard):
        if checksum(packet[_ID_AT:-1]) == packet[-1]:
            answers.append(FeetechAnswer(packet[_ID_AT], packet[_STATUS_AT], packet[_DATA_AT:-1]))
        else:
            damaged += 1
    return answers, damaged


def _packets(heard: bytes) -> Iterator[bytes]:
    at = heard.find(HEADER)
    while at >= 0 and len(heard) - at >= OVERHEAD:
        if heard[at + _ID_AT] == 0xFF:  # one more of the header's bytes: no ID
            at += 1
            continue
        end = at + _LENGTH_AT + 1 + heard[at + _LENGTH_AT]
        if end <= len(heard) and end - at >= OVERHEAD:
            yield heard[at:end]
            at = heard.find(HEADER, end)
        else:
            at = heard.find(HEADER, at + 2)
