# SPDX-License-Identifier: Apache-2.0
"""Packets of Feetech's SCS protocol as a servo sees them.

FF FF ID LENGTH INSTRUCTION PARAMETERS CHECKSUM (Feetech, "Communication protocol manual").
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

BROADCAST_ID: Final = 0xFE
_HEADER: Final = b"\xff\xff"
_OVERHEAD: Final = 6
_MAX_LENGTH: Final = 250


class FeetechInstruction(IntEnum):
    """Instructions of the protocol."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RESET_TURNS = 0x0A
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


@dataclass(frozen=True, slots=True)
class FeetechPacket:
    """One instruction whose checksum is right."""

    device_id: int
    instruction: int
    parameters: bytes


def encode_status(device_id: int, status: int, parameters: bytes = b"") -> bytes:
    """A servo's answer."""
    body = bytes([device_id, len(parameters) + 2, status]) + parameters
    return _HEADER + body + bytes([~sum(body) & 0xFF])


class FeetechPacketReader:
    """Finds packets in a stream; those with a wrong checksum are dropped without a word (assumption)."""

    def __init__(self) -> None:
        self._heard = bytearray()

    @property
    def pending(self) -> bool:
        """Whether a packet has begun."""
        return bool(self._heard)

    def reset(self) -> None:
        """Forget what has begun."""
        self._heard.clear()

    def feed(self, data: bytes) -> Iterator[FeetechPacket]:
        """Packets that end in these bytes."""
        self._heard += data
        while True:
            start = self._heard.find(_HEADER)
            if start < 0:
                del self._heard[: max(0, len(self._heard) - 1)]
                return
            del self._heard[:start]
            if len(self._heard) < _OVERHEAD - 2:
                return
            if self._heard[2] == _HEADER[0] or not 2 <= self._heard[3] <= _MAX_LENGTH:
                del self._heard[:1]
                continue
            end = 4 + self._heard[3]
            if len(self._heard) < end:
                return
            body = bytes(self._heard[2:end])
            del self._heard[:end]
            if ~sum(body[:-1]) & 0xFF == body[-1]:
                yield FeetechPacket(body[0], body[2], body[3:-1])
