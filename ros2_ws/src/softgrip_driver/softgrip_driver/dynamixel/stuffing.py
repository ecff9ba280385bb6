# SPDX-License-Identifier: Apache-2.0
"""Byte stuffing of Protocol 2.0, in place of dynamixel-sdk's.

The SDK (4.0.3, 4.1.0) computes the stuffed packet and drops it: `addStuffing` binds a new list, `txPacket` ignores the
return value, so a goal position such as -131073 (FF FF FD FF) goes out with a false header inside. Its `removeStuffing`
reads bytes that it has overwritten and takes FF FD FD for a stuffed sequence once it has removed one before.
"""

from __future__ import annotations

from collections.abc import Sequence

from dynamixel_sdk import Protocol2PacketHandler

_LENGTH_AT = 5
_INSTRUCTION_AT = 7


def stuff(body: Sequence[int]) -> list[int]:
    """Return instruction and parameters with FD added after every FF FF FD."""
    out: list[int] = []
    for byte in body:
        out.append(byte)
        if byte == 0xFD and out[-3:-1] == [0xFF, 0xFF]:
            out.append(0xFD)
    return out


def unstuff(body: Sequence[int]) -> list[int]:
    """Return instruction and parameters with the FD after every FF FF FD taken out."""
    out: list[int] = []
    skip = False
    for byte in body:
        if skip and byte == 0xFD:
            skip = False
            continue
        out.append(byte)
        skip = byte == 0xFD and out[-3:-1] == [0xFF, 0xFF]
    return out


class PacketHandler(Protocol2PacketHandler):  # type: ignore[misc]  # dynamixel-sdk has no types
    """The SDK's packet handler with stuffing that reaches the wire."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802  the SDK's name
        """Stuff a packet in place; its CRC bytes are still empty."""
        length = packet[_LENGTH_AT] | packet[_LENGTH_AT + 1] << 8
        self._replace_body(packet, stuff(packet[_INSTRUCTION_AT : _INSTRUCTION_AT + length - 2]), packet[-2:])
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802  the SDK's name
        """Unstuff a packet in place; what follows the body is its CRC."""
        length = packet[_LENGTH_AT] | packet[_LENGTH_AT + 1] << 8
        if length >= 3:
            crc_at = _INSTRUCTION_AT + length - 2
            self._replace_body(packet, unstuff(packet[_INSTRUCTION_AT:crc_at]), packet[crc_at : crc_at + 2])
        return packet

    @staticmethod
    def _replace_body(packet: list[int], body: list[int], crc: list[int]) -> None:
        length = len(body) + 2
        packet[_LENGTH_AT:] = [length & 0xFF, length >> 8, *body, *crc]
