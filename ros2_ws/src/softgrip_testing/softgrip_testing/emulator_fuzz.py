# SPDX-License-Identifier: Apache-2.0
"""The devices' side of the wires, to be fed noise (`make fuzz`, tools/fuzz.py).

A finding is an exception, or a change of a register by a stream that holds no whole packet. The stream is printed as
hex.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Final

from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.packets import BROADCAST_ID, HEADER, Instruction, crc16, encode
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.rig.grbl import EmulatedGrblStage
from softgrip_emulator.rig.mark10_gauge import EmulatedMark10Gauge
from softgrip_emulator.rig.mark10_stand import EmulatedMark10Stand
from softgrip_emulator.rig.plant import RigPlant
from softgrip_emulator.rig.sensor import LoadCell
from softgrip_emulator.rig.truth import RigTruth

if TYPE_CHECKING:
    from softgrip_emulator.wire.device import WireDevice

_BAUD, _TEXT_BAUD = 57_600, 115_200
READERS: Final = ("softgrip_emulator.dynamixel", "softgrip_emulator.rig")
"""Whose branches atheris watches."""
_PAUSE_S: Final = 1.0
"""Between two streams: ends a packet that one of them has begun."""
SEEDS: Final = (
    encode(1, Instruction.PING),
    encode(1, Instruction.READ, bytes([132, 0, 4, 0])),
    encode(1, Instruction.WRITE, bytes([116, 0, 0, 2, 0, 0])),
    encode(2, Instruction.REG_WRITE, bytes([102, 0, 9, 0])),
    encode(BROADCAST_ID, Instruction.ACTION),
    encode(3, Instruction.CLEAR, bytes([1, 0x44, 0x58, 0x4C, 0x22])),
    encode(1, Instruction.REBOOT),
    encode(BROADCAST_ID, Instruction.SYNC_READ, bytes([132, 0, 4, 0, 1, 2, 3])),
    encode(BROADCAST_ID, Instruction.FAST_SYNC_READ, bytes([126, 0, 10, 0, 1, 2, 3])),
    encode(BROADCAST_ID, Instruction.SYNC_WRITE, bytes([116, 0, 4, 0, 1, 0, 0, 0, 0])),
    encode(BROADCAST_ID, Instruction.BULK_READ, bytes([1, 144, 0, 2, 0, 2, 146, 0, 1, 0])),
    encode(BROADCAST_ID, Instruction.BULK_WRITE, bytes([1, 65, 0, 1, 0, 1])),
    b"ile0040.0h012.50uxpnsz",
    b"?\rLIST\rAOUT10\rLB\rZ\r",
    b"$X\n$I\nG21 G90\n$J=G53 G21 G90 X1.500 F40.0\n?\x85\x18",
)


class EmulatorFuzzTarget:
    """A chain of three servos, a stand, a stage and a gauge that are fed one stream after another."""

    def __init__(self) -> None:
        model = load_model("xl330_m288")
        self._chain = DynamixelChain([EmulatedServo(model, number, baud=_BAUD) for number in (1, 2, 3)])
        truth = RigTruth.from_seed(1)
        plant = RigPlant(truth, 1)
        cell = LoadCell(plant, 50.0, 1)
        self._text: list[WireDevice] = [
            EmulatedMark10Stand(plant, cell),
            EmulatedGrblStage(plant),
            EmulatedMark10Gauge(cell),
        ]
        self._now_s = 0.0

    def feed(self, stream: bytes) -> None:
        """Feed a stream.

        Raises:
            AssertionError: the stream changed a register and holds no whole packet.
        """
        before = [servo.registers.snapshot() for servo in self._chain.servos]
        self._now_s += _PAUSE_S
        self._chain.exchange(stream, self._now_s, _BAUD)
        settled = all(
            _settings(old) == _settings(servo.registers.snapshot())
            for old, servo in zip(before, self._chain.servos, strict=True)
        )
        assert settled or holds_packet(stream), f"obeyed a stream without a packet: {stream.hex(' ')}"
        for device in self._text:
            # Letters are commands here and carry no checksum: nothing but an exception can be wrong.
            device.exchange(stream, self._now_s, _TEXT_BAUD)


def _settings(memory: bytes) -> bytes:
    """The part of a table that only a host changes: all but the present values."""
    return memory[:120] + memory[148:]


def holds_packet(stream: bytes) -> bool:
    """Whether a whole packet with a right CRC stands somewhere in a stream."""
    start = stream.find(HEADER)
    while start >= 0:
        end = start + 7 + int.from_bytes(stream[start + 5 : start + 7], "little")
        if start + 10 <= end <= len(stream):
            crc = int.from_bytes(stream[end - 2 : end], "little")
            if crc16(stream[start : end - 2]) == crc:
                return True
        start = stream.find(HEADER, start + 1)
    return False


def mutate(packet: bytes, rng: random.Random) -> bytes:
    """Flip, drop, insert or replace a few bytes."""
    data = bytearray(packet)
    for _ in range(rng.randrange(1, 5)):
        place = rng.randrange(len(data) + 1)
        match rng.randrange(4):
            case 0 if place < len(data):
                data[place] ^= 1 << rng.randrange(8)
            case 1 if place < len(data):
                del data[place]
            case 2 if place < len(data):
                data[place] = rng.choice((0x00, 0xFD, 0xFF))
            case _:
                data.insert(place, rng.randrange(256))
    return bytes(data)


#: What `tools/fuzz.py` feeds.
TARGET = EmulatorFuzzTarget
