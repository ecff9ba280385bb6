# SPDX-License-Identifier: Apache-2.0
"""A linear stage on a GRBL 1.1 or grblHAL controller, as a stage; its X axis pulls.

Every motion is a jog ($J=) with a distance, so that it ends by itself when this process dies; 0x85 cancels one at once.
Sources: gnea/grbl (bfb67f0) doc/markdown/{interface,jogging,commands,settings}.md; grblHAL/core (f80fc34) report.c.
"""

from __future__ import annotations

import contextlib
import re
from enum import StrEnum

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, DriverError, NoReplyError, NotReadyError
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.line_port import LinePort

BAUD = 115200
_STATUS, _JOG_CANCEL, _SOFT_RESET = b"?", b"\x85", b"\x18"
#: [s] of silence after which it is asked whether it runs already.
_QUIET_TIME = 0.4
#: [s] an Arduino's boot loader takes before GRBL says hello.
_BOOT_TIME = 2.5
#: [s] without another banner: some boards are reset twice when their port is opened
_BANNER_QUIET_TIME = 0.15
#: [s] to come to rest when it was moving
_SETTLE_TIME = 2.0
#: [s] for all settings; grblHAL has some two hundred
_SETTINGS_TIME = 3.0
#: [s] for the way to the switches and back off them
HOMING_TIMEOUT_S = 90.0
_MM_PER_INCH = 25.4
#: [mm] a step longer than this is coarser than what counts as arrived
_MAX_STEP_MM = 0.03
#: reports among which there is one with the work offset: every tenth to thirtieth has it (interface.md)
_OFFSET_REPORTS = 31
#: bit of $10: machine position (MPos), else work position (WPos)
_MACHINE_POSITION = 1
_BANNER = re.compile(rb"Grbl(?:HAL)? (\S+) .*")
_VERSION = re.compile(rb"\[VER:([^:\]]+).*\]")
_HAL = b"[FIRMWARE:grblHAL]"
_SETTING = re.compile(rb"\$(\d+)=([-+.\d]+).*")
_REPORT = re.compile(rb"<(?P<state>[A-Za-z]+)(?::\d+)?\|(?P<fields>.*)>")
_POSITION = re.compile(rb"(?P<kind>[MW])Pos:(?P<x>-?\d+\.\d+)(?:,-?\d+\.\d+)*")
_OFFSET = re.compile(rb"WCO:(-?\d+\.\d+)")
_NOT_IDLE = "8"
_ERRORS = {
    "5": "homing is switched off: $22=1 where it has switches",
    _NOT_IDLE: "the controller is not idle",
    "9": "it is locked by an alarm: clear the cause, then send $X or home it",
    "15": "the target lies beyond its soft limits",
    "16": "the jog command was not understood",
    "22": "no feed rate",
    "46": "grblHAL wants it homed ($22 has the bit 4): set stage_start to home",
}


class StageStart(StrEnum):
    """What to do where a stage is locked when it is opened, as each one with switches ($22=1) is.

    Opening the port resets it, so a lock that was left by hand before is there again.
    """

    REFUSE = "refuse"
    UNLOCK = "unlock"
    HOME = "home"


class GrblStage:
    """The stage.

    Args:
        port: its serial port (115200 8N1); opening it resets most controllers.
        boot_time: [s] to wait for its banner.
        start: what to do where it is locked.
    """

    def __init__(self, port: LinePort, boot_time: float = _BOOT_TIME, start: StageStart = StageStart.REFUSE) -> None:
        self._port = port
        self._boot_time = boot_time
        self._start = start
        self._zero_mm = 0.0
        self._offset_mm: float | None = 0.0
        self._mm_per_unit = 1.0
        self.is_homed = False
        """It has driven to its switches since it was opened."""

    def open(self) -> DeviceIdentity:
        """Connect, wait until it runs, stand still, read its settings, leave a lock as asked, set millimetres.

        Raises:
            RefusedError: it is locked by an alarm.
        """
        self._port.open()
        self.is_homed = False
        version = self._await_running()
        self.stop()
        warnings = self._take_settings(self._settings())
        state = self._settled_state()
        if state == "Alarm" and self._start is not StageStart.REFUSE:
            self.home() if self._start is StageStart.HOME else self.unlock()
            state = self._report()[0]
        if state in {"Alarm", "Door", "Sleep"}:
            raise DeviceRefusedError(
                f"GRBL: expected it idle, found it in {state}: make the axis free; where it has switches ($22=1) it is "
                "locked whenever its port is opened: set stage_start to home (it drives to its switches at once) or to "
                "unlock ($X)",
                0,
            )
        self._command("G21 G90")
        self._zero_mm = self._report()[1]
        return DeviceIdentity(version, warnings=warnings)

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
        try:
            self._begin_line()
            self._command("$X")
        except NoReplyError:
            # After a limit was hit it hears nothing but a reset, so that nobody goes on by mistake (protocol.c).
            self._port.write(_SOFT_RESET)
            self._await_running()
            self._command("$X")

    def home(self) -> None:
        """Drive to the switches and back off them ($H), which moves it at once.

        Raises:
            RefusedError: it has none ($22=0), or did not find them.
        """
        self._begin_line()
        try:
            self._command("$H", HOMING_TIMEOUT_S)
        except DeviceRefusedError as error:
            raise DeviceRefusedError(f"GRBL: expected it to find its switches: {error}", error.code) from error
        self.is_homed = True

    def close(self) -> None:
        """Stop and disconnect."""
        if self._port.is_open:
            with contextlib.suppress(DriverError):
                self.stop()
        self._port.close()

    def _settled_state(self) -> str:
        """Return its state once a motion that another process began has come to rest."""
        end = self._port.clock.now_s() + _SETTLE_TIME
        while (state := self._report()[0]) in {"Jog", "Run", "Hold"} and self._port.clock.now_s() < end:
            pass
        return state

    def _await_running(self) -> str:
        """Wait for the hello of a restart; a board that opening its port does not restart is asked who it is."""
        end = self._port.clock.now_s() + self._boot_time
        while True:
            try:
                line = self._port.read_line(min(_QUIET_TIME, max(end - self._port.clock.now_s(), 0.0)))
            except NoReplyError:
                if self._port.clock.now_s() >= end:
                    raise
                # No soft reset: on a board that boots it would only make for another banner.
                self._port.write(_STATUS)
                continue
            if line.startswith(b"<"):
                return self._ask_version()
            if match := _BANNER.fullmatch(line):
                self._port.drain(_BANNER_QUIET_TIME)
                name = "grblHAL" if line.startswith(b"GrblHAL") else "GRBL"
                return f"{name} {match[1].decode('ascii', 'replace')}"

    def _ask_version(self) -> str:
        """Return what $I says of a controller that was running already; its position is still good."""
        self.stop()
        lines = self._ask_lines(b"$I")
        name = "grblHAL" if _HAL in lines else "GRBL"
        found = [match[1].decode("ascii", "replace") for line in lines if (match := _VERSION.fullmatch(line))]
        return " ".join([name, *found[:1]])

    def _settings(self) -> dict[int, float]:
        """Return its settings ($$) by number, also while it is locked."""
        found = {}
        for line in self._ask_lines(b"$$"):
            if match := _SETTING.fullmatch(line):
                with contextlib.suppress(ValueError):  # a damaged number is as good as none
                    found[int(match[1])] = float(match[2])
        missing = {10, 13, 100} - found.keys()
        if missing:
            names = ", ".join(f"${number}" for number in sorted(missing))
            raise CorruptReplyError(f"GRBL: expected {names} among its settings ($$), found {len(found)} others")
        return found

    def _take_settings(self, settings: dict[int, float]) -> tuple[str, ...]:
        """Follow what changes the meaning of its reports; return what a person should know."""
        warnings = []
        self._mm_per_unit = _MM_PER_INCH if settings[13] else 1.0
        if settings[13]:
            warnings.append("$13=1: it reports inches; they are converted")
        # Until a report has told it, the offset of a work position is not known.
        self._offset_mm = 0.0 if int(settings[10]) & _MACHINE_POSITION else None
        if settings[100] <= 0.0 or 1.0 / settings[100] > _MAX_STEP_MM:
            warnings.append(f"$100={settings[100]:g} steps/mm: steps coarser than {_MAX_STEP_MM:g} mm")
        if settings.get(22, 0.0) == 0.0:
            warnings.append("$22=0: it does not know where its axis ends")
        return tuple(warnings)

    def _begin_line(self) -> None:
        """End what noise may have begun in its line buffer: an empty line is answered, too (protocol.c).

        grblHAL has something of a cancelled jog (0x85) left there while it is locked.
        """
        self._port.drain()
        self._port.write(b"\n")
        self._answer(b"ok", b"error:")

    def _ask_lines(self, command: bytes) -> list[bytes]:
        """Return the lines of an answer that ends with ok."""
        self._begin_line()
        self._port.write(command + b"\n")
        lines, end = [], self._port.clock.now_s() + _SETTINGS_TIME
        while (line := self._port.read_line(max(end - self._port.clock.now_s(), 0.0))) != b"ok":
            if line.startswith(b"error:"):
                raise DeviceRefusedError(f"GRBL: expected settings, found {line!r}", 0)
            lines.append(line)
        return lines

    def _report(self) -> tuple[str, float]:
        """Return state and machine position of X [mm]."""
        for _ in range(_OFFSET_REPORTS):
            state, kind, x = self._ask_report()
            if kind == b"M":
                return state, x
            if self._offset_mm is not None:
                return state, x + self._offset_mm
        raise CorruptReplyError(
            f"GRBL: expected the work offset (WCO) in one of {_OFFSET_REPORTS} reports, found none; set $10=1"
        )

    def _ask_report(self) -> tuple[str, bytes, float]:
        """Return state, kind of position (M, W) and X [mm] of one report, and keep the offset where it has one."""
        self._port.drain()
        self._port.write(_STATUS)
        match = _REPORT.fullmatch(self._answer(b"<"))
        if match is None:
            raise CorruptReplyError("GRBL: expected a whole status report <State|MPos:x,y,z|...>, found a damaged one")
        offset = _OFFSET.search(match["fields"])
        if offset:
            self._offset_mm = float(offset[1]) * self._mm_per_unit
        position = _POSITION.search(match["fields"])
        if position is None:
            raise CorruptReplyError(f"GRBL: expected a position in the report, found {match['fields']!r}; set $10=1")
        return match["state"].decode(), position["kind"], float(position["x"]) * self._mm_per_unit

    def _command(self, text: str, timeout: float | None = None) -> None:
        self._port.drain()
        self._port.write(text.encode("ascii") + b"\n")
        answer = self._answer(b"ok", b"error:", timeout=timeout).decode("ascii", "replace")
        if answer != "ok":
            code = answer.removeprefix("error:")
            reason = _ERRORS.get(code, "see GRBL's list of errors")
            kind = NotReadyError if code == _NOT_IDLE else DeviceRefusedError
            raise kind(f"GRBL: expected 'ok' to '{text}', found '{answer}': {reason}", _number(code))

    def _answer(self, *beginnings: bytes, timeout: float | None = None) -> bytes:
        """Return the next line that begins as expected; GRBL pushes [MSG:...] and empty lines in between."""
        end = self._port.clock.now_s() + (self._port.reply_time if timeout is None else timeout)
        while True:
            line = self._port.read_line(max(end - self._port.clock.now_s(), 0.0))
            if line.startswith(beginnings):
                return line
            if line.startswith((b"ALARM:", b"Grbl")):
                heard = line.decode("ascii", "replace")
                raise DeviceRefusedError(f"GRBL: expected an answer, found '{heard}': the position is lost; home it", 0)
            if self._port.clock.now_s() >= end:
                raise NoReplyError(f"port {self._port.path}: expected {beginnings!r}, found {line!r}")


def _number(code: str) -> int:
    """Return an error code; a damaged one is 0."""
    return int(code) if code.isascii() and code.isdigit() else 0
