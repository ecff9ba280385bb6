# SPDX-License-Identifier: Apache-2.0
"""A linear stage on a GRBL 1.1 controller, as a stage; its X axis pulls.

Every motion is a jog ($J=) with a distance, so that it ends by itself when this process dies; 0x85 cancels one at once.
Source: gnea/grbl, doc/markdown/{interface,jogging,commands}.md.
"""

from __future__ import annotations

import contextlib
import re
import time

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, DriverError, NoReplyError
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.errors import NotReadyError
from softgrip_driver.rig.line_port import LinePort

BAUD = 115200
_STATUS, _JOG_CANCEL, _SOFT_RESET = b"?", b"\x85", b"\x18"
#: [s] of silence after which it is restarted.
_QUIET_TIME = 0.4
#: [s] an Arduino's boot loader takes before GRBL says hello.
_BOOT_TIME = 2.5
_BANNER = re.compile(rb"Grbl (\S+) .*")
_REPORT = re.compile(rb"<(?P<state>[A-Za-z]+)(?::\d)?\|(?P<fields>.*)>")
_POSITION = re.compile(rb"(?P<kind>[MW])Pos:(?P<x>-?\d+\.\d+)(?:,-?\d+\.\d+)*")
_OFFSET = re.compile(rb"WCO:(-?\d+\.\d+)")
_NOT_IDLE = "8"
_ERRORS = {
    _NOT_IDLE: "the controller is not idle",
    "9": "it is locked by an alarm: clear the cause, then send $X or home it",
    "15": "the target lies beyond its soft limits",
    "16": "the jog command was not understood",
    "22": "no feed rate",
}


class GrblStage:
    """The stage.

    Args:
        port: its serial port (115200 8N1); opening it resets the controller.
        boot_time: [s] to wait for its banner.
    """

    def __init__(self, port: LinePort, boot_time: float = _BOOT_TIME) -> None:
        self._port = port
        self._boot_time = boot_time
        self._zero_mm = 0.0
        self._offset_mm = 0.0

    def open(self) -> DeviceIdentity:
        """Connect, wait for the banner, stand still, set millimetres.

        Raises:
            RefusedError: it is locked by an alarm.
        """
        self._port.open()
        version = self._banner()
        self.stop()
        state, position = self._report()
        if state in {"Alarm", "Door", "Sleep"}:
            raise DeviceRefusedError(
                f"GRBL: expected it idle, found it in {state}: make the axis free, then send $X or home it", 0
            )
        self._command("G21 G90")
        self._zero_mm = position
        return DeviceIdentity(f"GRBL {version}")

    def zero(self) -> None:
        """Make this the zero of travel."""
        self._zero_mm = self._report()[1]

    def start(self, target: float, speed: float) -> None:
        """Begin to move to a travel [m] at a speed [m/s].

        Raises:
            RefusedError: GRBL's own reason.
        """
        millimetres = target * 1e3 + self._zero_mm
        self._command(f"$J=G53 G21 G90 X{millimetres:.3f} F{speed * 60e3:.1f}")

    def travel(self) -> float:
        """Where the stage is [m].

        Raises:
            RefusedError: an alarm: the position is not known any more.
        """
        state, position = self._report()
        if state == "Alarm":
            raise DeviceRefusedError("GRBL: alarm: a limit switch was hit or it was reset in motion; home it again", 0)
        return (position - self._zero_mm) * 1e-3

    def stop(self) -> None:
        """Stand still now."""
        self._port.write(_JOG_CANCEL)

    def unlock(self) -> None:
        """Leave an alarm ($X)."""
        self._command("$X")

    def close(self) -> None:
        """Stop and disconnect."""
        if self._port.is_open:
            with contextlib.suppress(DriverError):
                self.stop()
        self._port.close()

    def _banner(self) -> str:
        """Wait for the hello of a restart; boards that do not restart when their port is opened are restarted."""
        end = time.monotonic() + self._boot_time
        while True:
            try:
                match = _BANNER.fullmatch(self._port.read_line(min(_QUIET_TIME, max(end - time.monotonic(), 0.0))))
            except NoReplyError:
                if time.monotonic() >= end:
                    raise
                self._port.write(_SOFT_RESET)
                continue
            if match:
                return match[1].decode("ascii", "replace")

    def _report(self) -> tuple[str, float]:
        """Return state and machine position of X [mm]."""
        self._port.drain()
        self._port.write(_STATUS)
        match = _REPORT.fullmatch(self._answer(b"<"))
        if match is None:
            raise CorruptReplyError("GRBL: expected a whole status report <State|MPos:x,y,z|...>, found a damaged one")
        offset = _OFFSET.search(match["fields"])
        if offset:
            self._offset_mm = float(offset[1])
        position = _POSITION.search(match["fields"])
        if position is None:
            raise CorruptReplyError(f"GRBL: expected a position in the report, found {match['fields']!r}; set $10=1")
        x = float(position["x"])
        return match["state"].decode(), x if position["kind"] == b"M" else x + self._offset_mm

    def _command(self, text: str) -> None:
        self._port.drain()
        self._port.write(text.encode("ascii") + b"\n")
        answer = self._answer(b"ok", b"error:").decode("ascii", "replace")
        if answer != "ok":
            code = answer.removeprefix("error:")
            reason = _ERRORS.get(code, "see GRBL's list of errors")
            kind = NotReadyError if code == _NOT_IDLE else DeviceRefusedError
            raise kind(f"GRBL: expected 'ok' to '{text}', found '{answer}': {reason}", _number(code))

    def _answer(self, *beginnings: bytes) -> bytes:
        """Return the next line that begins as expected; GRBL pushes [MSG:...] and empty lines in between."""
        end = time.monotonic() + self._port.reply_time
        while True:
            line = self._port.read_line(max(end - time.monotonic(), 0.0))
            if line.startswith(beginnings):
                return line
            if line.startswith((b"ALARM:", b"Grbl ")):
                heard = line.decode("ascii", "replace")
                raise DeviceRefusedError(f"GRBL: expected an answer, found '{heard}': the position is lost; home it", 0)
            if time.monotonic() >= end:
                raise NoReplyError(f"port {self._port.path}: expected {beginnings!r}, found {line!r}")


def _number(code: str) -> int:
    """Return an error code; a damaged one is 0."""
    return int(code) if code.isascii() and code.isdigit() else 0
