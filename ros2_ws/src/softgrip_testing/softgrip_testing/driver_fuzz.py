# SPDX-License-Identifier: Apache-2.0
"""Everything that reads a device's bytes, to be fed noise (`make fuzz`, tools/fuzz.py).

A finding is an exception that is none of the driver's own, a value of a servo that stands in no whole packet of the
stream, or a number that is none. The stream is printed as hex.
"""

from __future__ import annotations

import math
import os
import random
from collections.abc import Callable, Sequence

from softgrip_driver.dynamixel.bus import BROADCAST, Bus
from softgrip_driver.dynamixel.stuffing import unstuff
from softgrip_driver.errors import DeviceRefusedError, DriverError, NoReplyError
from softgrip_driver.rig import mark10
from softgrip_driver.rig.grbl import GrblStage
from softgrip_driver.rig.line_format import FORMATS
from softgrip_driver.rig.line_gauge import LineGauge
from softgrip_driver.rig.mark10_gauge import Mark10Gauge
from softgrip_driver.rig.mark10_stand import Mark10Stand
from softgrip_time import WallClock

#: whose branches atheris watches
READERS = ("softgrip_driver.dynamixel", "softgrip_driver.rig", "dynamixel_sdk")
HEADER = bytes.fromhex("ff ff fd 00")
_STATUS = 0x55
_ADDRESS, _SIZE = 132, 4
#: replies of servos (e-manual) and lines of stand, gauge, stage and amplifiers (manuals), to begin with
SEEDS = (
    bytes.fromhex("ff ff fd 00 01 08 00 55 00 a6 00 00 00 8c c0"),
    bytes.fromhex("ff ff fd 00 01 04 00 55 00 a1 0c"),
    bytes.fromhex("ff ff fd 00 fe 19 00 55 00 03 a6 00 00 00 84 08 00 07 1f 08 00 00 16 ca 00 04 ff 03 00 00 d1 9e"),
    b"2.00 mm\r\n40.0 mm/min\r\nUL L\r\n",
    b"-18.78 N\r\nV1.00;N;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0\r\n*10\r\n",
    b"<Idle|MPos:1.250,0.000,0.000|Bf:15,128|FS:0,0|WCO:0.000,0.000,0.000>\r\nok\r\nerror:15\r\nALARM:1\r\n",
    b"Reading: 12.34 g\r\n1200,3.4000,kg,24.5,\r\nST,GS,+ 12.345kg\r\n8388607\r\n",
)
_TEXT_PARSERS: tuple[Callable[[bytes], object], ...] = (
    mark10.parse_travel, mark10.parse_number, mark10.parse_reading, mark10.parse_list,
    *(one.parse for one in FORMATS.values()),
)  # fmt: skip


def crc16(data: bytes) -> int:
    """Bitwise CRC-16 of the e-manual (0x8005, not reflected), independent of the SDK's table."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


class ScriptedSerial:
    """Stands where pyserial's Serial does: answers each write with the next scripted reply."""

    def __init__(self, replies: Sequence[bytes] = ()) -> None:
        self.replies, self.sent = list(replies), list[bytes]()
        self.fd, self.writer = os.pipe()
        os.set_blocking(self.fd, False)

    def write(self, data: Sequence[int]) -> int:
        """Take an instruction; its reply can be read afterwards."""
        self.sent.append(bytes(data))
        if self.replies:
            os.write(self.writer, self.replies.pop(0))
        return len(data)

    def read(self, size: int) -> bytes:
        """Return what is there."""
        try:
            return os.read(self.fd, size)
        except BlockingIOError:
            return b""

    def reset_input_buffer(self) -> None:
        """Throw away what is there."""
        while self.read(4096):
            pass

    def close(self) -> None:
        """Close both ends."""
        os.close(self.fd)
        os.close(self.writer)


class ScriptedPort:
    """Stands where a LinePort does: gives the lines of a stream, then silence."""

    path, reply_time, is_open = "scripted", 0.0, True
    clock = WallClock()

    def __init__(self, stream: bytes) -> None:
        *self._lines, self._rest = stream.split(b"\n")

    def write(self, data: bytes) -> None:
        """Nobody listens."""

    def drain(self, quiet: float = 0.0) -> int:
        """Nothing comes unasked."""
        del quiet
        return 0

    def read_next_line(self, timeout: float | None = None) -> bytes:
        """Return the next line: each begins when it is asked for."""
        return self.read_line(timeout)

    def read_line(self, timeout: float | None = None, length: int = 0) -> bytes:
        """Return the next line, or so many bytes of it."""
        del timeout
        if not self._lines:
            raise NoReplyError(f"expected a line, found {self._rest[:40]!r}")
        line = self._lines.pop(0).rstrip(b"\r")
        return line[:length] if length else line


class DriverFuzzTarget:
    """Everything that reads bytes of a device, fed one stream after another."""

    def __init__(self) -> None:
        self._serial = ScriptedSerial()
        self._bus = Bus("scripted", 1_000_000, 0.0)
        self._bus.port.ser, self._bus.port.is_open, self._bus.port.tx_time_per_byte = self._serial, True, 0.0

    def feed(self, stream: bytes) -> None:
        """Feed a stream.

        Raises:
            AssertionError: a value was taken that is not in it.
        """
        self._read(stream)
        self._read_groups(stream)
        for line in (stream, *stream.split(b"\r\n")):
            for parse in _TEXT_PARSERS:
                _only_numbers(lambda parse=parse, line=line: parse(line))  # type: ignore[misc]  # bound at once
        for ask in _devices(stream):
            _only_numbers(ask)

    def _read(self, stream: bytes) -> None:
        self._serial.replies = [stream]
        try:
            data = self._bus.read_bytes(1, _ADDRESS, _SIZE).data
        except DeviceRefusedError:
            assert any(servo == 1 for servo, _ in packets(stream)), f"a refusal out of {stream.hex(' ')}"
        except DriverError:
            return
        else:
            assert (1, data) in packets(stream), f"took {data.hex(' ')} out of {stream.hex(' ')}"

    def _read_groups(self, stream: bytes) -> None:
        self._serial.replies = [stream]
        found = packets(stream)
        for servo, reply in self._bus.sync_read([3, 7, 4], _ADDRESS, _SIZE).items():
            assert (servo, reply.data) in found, f"took {reply.data.hex(' ')} out of {stream.hex(' ')}"
        self._serial.replies = [stream]
        if self._bus.fast_sync_read([3, 7, 4], _ADDRESS, _SIZE):
            assert any(servo == BROADCAST for servo, _ in found), f"took a group out of {stream.hex(' ')}"


def packets(stream: bytes) -> list[tuple[int, bytes]]:
    """Return (ID, data) of every whole status packet with a right CRC, wherever it begins."""
    found = []
    start = stream.find(HEADER)
    while start >= 0:
        end = start + 7 + int.from_bytes(stream[start + 5 : start + 7], "little")
        if start + 11 <= end <= len(stream) and crc16(stream[start : end - 2]) == int.from_bytes(
            stream[end - 2 : end], "little"
        ):
            body = bytes(unstuff(stream[start + 7 : end - 2]))
            if body[:1] == bytes((_STATUS,)):
                found.append((stream[start + 4], body[2:]))
        start = stream.find(HEADER, start + 1)
    return found


def _devices(stream: bytes) -> list[Callable[[], object]]:
    def port() -> ScriptedPort:
        return ScriptedPort(stream)

    # The fakes have the verbs of LinePort that these use.
    stage, stand, gauge = GrblStage(port(), 0.0), Mark10Stand(port()), Mark10Gauge(port())  # type: ignore[arg-type]
    amplifiers = [LineGauge(port(), one) for one in FORMATS.values()]  # type: ignore[arg-type]
    return [stage.travel, stand.travel, gauge.tension, *(one.tension for one in amplifiers),
            lambda: GrblStage(port(), 0.0).start(0.001, 0.001)]  # type: ignore[arg-type]  # fmt: skip


def _only_numbers(ask: Callable[[], object]) -> None:
    try:
        answer = ask()
    except DriverError:
        return
    number = answer[0] if isinstance(answer, tuple) else answer
    assert not isinstance(number, float) or math.isfinite(number), f"took {number} for a number"


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Damage a stream: flip a bit, lose, double or insert a byte, cut it, or replace it by noise."""
    out = bytearray(data)
    at = rng.randrange(len(out))
    match rng.randrange(6):
        case 0:
            out[at] ^= 1 << rng.randrange(8)
        case 1:
            del out[at]
        case 2:
            out.insert(at, out[at])
        case 3:
            out.insert(at, rng.randrange(256))
        case 4:
            del out[at:]
        case _:
            out = bytearray(rng.randbytes(rng.randrange(40)))
    return bytes(out)


#: What `tools/fuzz.py` feeds.
TARGET = DriverFuzzTarget
