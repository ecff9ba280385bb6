# SPDX-License-Identifier: Apache-2.0
"""Throw noise at the devices' side of the wires for a bounded time; coverage-guided when atheris is installed.

A finding is an exception, or a change of a register by a stream that holds no whole packet. The stream is printed as
hex.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import importlib.util
import random
import sys
import tempfile
import time
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Final

from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.packets import BROADCAST_ID, HEADER, Instruction, crc16, encode
from softgrip_emulator.dynamixel.servo import Servo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.rig.grbl import GrblStage
from softgrip_emulator.rig.mark10_gauge import Mark10Gauge
from softgrip_emulator.rig.mark10_stand import Mark10Stand
from softgrip_emulator.rig.plant import RigPlant
from softgrip_emulator.rig.sensor import LoadCell
from softgrip_emulator.rig.truth import RigTruth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from softgrip_emulator.wire.device import WireDevice

_BAUD, _TEXT_BAUD = 57_600, 115_200
_READERS: Final = ("softgrip_emulator.dynamixel", "softgrip_emulator.rig")
"""Whose branches atheris watches."""
_PAUSE_S: Final = 1.0
"""Between two streams: ends a packet that one of them has begun."""
_SEEDS: Final = (
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


class Target:
    """A chain of three servos, a stand, a stage and a gauge that are fed one stream after another."""

    def __init__(self) -> None:
        model = load_model("xl330_m288")
        self._chain = DynamixelChain([Servo(model, number, baud=_BAUD) for number in (1, 2, 3)])
        truth = RigTruth.from_seed(1)
        plant = RigPlant(truth, 1)
        cell = LoadCell(plant, 50.0, 1)
        self._text: list[WireDevice] = [Mark10Stand(plant, cell), GrblStage(plant), Mark10Gauge(cell)]
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


def fuzz_at_random(seconds: float, seed: int) -> int:
    """Mutate known packets for a while; returns the number of streams."""
    rng, target, count = random.Random(seed), Target(), 0
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        for _ in range(500):
            stream = b"".join(mutate(rng.choice(_SEEDS), rng) for _ in range(rng.randrange(1, 4)))
            if rng.random() < 0.1:
                stream += rng.choice(_SEEDS)
            target.feed(stream)
            count += 1
    return count


def fuzz_with_atheris(seconds: float, seed: int) -> None:
    """Let atheris look for inputs that reach new code; it ends the process itself."""
    # optional: not everybody has a wheel for it
    atheris = importlib.import_module("atheris")
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and str(function.__module__).startswith(_READERS):
            atheris.instrument_func(function)
    target = Target()
    with tempfile.TemporaryDirectory() as corpus:
        for number, packet in enumerate(_SEEDS):
            Path(corpus, str(number)).write_bytes(packet)
        limits = [f"-max_total_time={int(seconds)}", f"-seed={seed}", "-max_len=200"]
        atheris.Setup([sys.argv[0], *limits, corpus], target.feed)
        atheris.Fuzz()


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="how long")
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    engines = ("auto", "random", "atheris")
    parser.add_argument("--engine", choices=engines, default="auto", help="auto: atheris when it is there")
    options = parser.parse_args(args)
    has_atheris = importlib.util.find_spec("atheris") is not None
    if options.engine == "atheris" and not has_atheris:
        print("fuzz: expected the package 'atheris', found none: pip install atheris", file=sys.stderr)
        return 2
    if options.engine != "random" and has_atheris:
        fuzz_with_atheris(options.seconds, options.seed)
        return 0
    count = fuzz_at_random(options.seconds, options.seed)
    print(f"{count} streams in {options.seconds:g} s: no exception, no register changed by a broken packet")
    return 0


if __name__ == "__main__":
    sys.exit(main())
