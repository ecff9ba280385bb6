# SPDX-License-Identifier: Apache-2.0
"""Dynamixel Protocol 2.0 packets as a servo sees them: bytes to instructions, status to bytes.

Source: ROBOTIS e-manual, docs/en/dxl/protocol2.md. Layout::

    FF FF FD 00 | ID | LEN_L LEN_H | INST | parameters | CRC_L CRC_H        LEN counts INST, parameters and CRC, stuffed
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

HEADER: Final = b"\xff\xff\xfd\x00"
BROADCAST_ID: Final = 0xFE
_MIN_LENGTH: Final = 3
_MAX_LENGTH: Final = 1024
"""Longer lengths come from noise: no host sends them and a servo has no room for them."""


class Instruction(IntEnum):
    """Instruction field (protocol2.md, "Instruction")."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusError(IntEnum):
    """Bits 6..0 of the status packet's error field."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


ALERT: Final = 0x80
"""Bit 7 of the error field: Hardware Error Status is not zero."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One instruction packet; `parameters` are unstuffed, `crc_ok` tells whether the CRC matched."""

    device_id: int
    instruction: int
    parameters: bytes
    crc_ok: bool = True


def _crc_table() -> tuple[int, ...]:
    table = []
    for index in range(256):
        remainder = index << 8
        for _ in range(8):
            remainder = (remainder << 1) ^ (0x8005 if remainder & 0x8000 else 0)
        table.append(remainder & 0xFFFF)
    return tuple(table)


_CRC_TABLE: Final = _crc_table()


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC-16 with polynomial 0x8005, start value `crc`, not reflected, no final inversion."""
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC_TABLE[(crc >> 8) ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Break up every FF FF FD by an extra FD, so that no header appears inside a packet."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo `stuff`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def encode(device_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """A whole packet, stuffed, with CRC."""
    body = stuff(bytes([instruction]) + parameters)
    head = HEADER + bytes([device_id]) + (len(body) + 2).to_bytes(2, "little") + body
    return head + crc16(head).to_bytes(2, "little")


def encode_status(device_id: int, error: int, parameters: bytes = b"") -> bytes:
    """A status packet."""
    return encode(device_id, Instruction.STATUS, bytes([error]) + parameters)


def encode_fast_status(parts: list[tuple[int, int, bytes]]) -> list[bytes]:
    """The common reply to Fast Sync Read or Fast Bulk Read, in the pieces that the servos contribute.

    Not stuffed (protocol2.md). Each piece ends with the CRC of everything from the header up to there.

    Args:
        parts: error, ID and data of each servo in the order asked for.
    """
    length = 1 + sum(len(data) + 4 for _, _, data in parts)
    pieces = []
    crc = 0
    for index, (error, device_id, data) in enumerate(parts):
        piece = bytes([error, device_id]) + data
        if index == 0:
            piece = HEADER + bytes([BROADCAST_ID]) + length.to_bytes(2, "little") + bytes([Instruction.STATUS]) + piece
        crc = crc16(piece, crc)
        trailer = crc.to_bytes(2, "little")
        crc = crc16(trailer, crc)
        pieces.append(piece + trailer)
    return pieces


class PacketReader:
    """Cuts a byte stream into packets; whatever is not a packet is passed over."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def reset(self) -> None:
        """Forget a packet that has begun (the line was silent for too long)."""
        self._buffer.clear()

    @property
    def pending(self) -> bool:
        """True while a packet has begun and not ended."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Packet]:
        """Append bytes and return the packets that are complete, those with a wrong CRC included."""
        self._buffer += data
        packets = []
        while (packet := self._next()) is not None:
            packets.append(packet)
        return packets

    def _next(self) -> Packet | None:
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                # Keep what may be the beginning of a header.
                del buffer[: max(0, len(buffer) - (len(HEADER) - 1))]
                return None
            del buffer[:start]
            if len(buffer) < len(HEADER) + 3:
                return None
            length = int.from_bytes(buffer[5:7], "little")
            if not _MIN_LENGTH <= length <= _MAX_LENGTH:
                del buffer[: len(HEADER)]
                continue
            end = 7 + length
            if len(buffer) < end:
                return None
            whole = bytes(buffer[:end])
            crc_ok = crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little")
            body = unstuff(whole[7:-2])
            # A packet of noise may have swallowed the start of a true one: search on from behind its header.
            del buffer[: end if crc_ok else len(HEADER)]
            return Packet(whole[4], body[0], body[1:], crc_ok)
