# SPDX-License-Identifier: Apache-2.0
"""A GRBL 1.1h or grblHAL controller whose X axis pulls the cable, at the device end of its wire.

Opening the port resets it (Arduino); real-time bytes are obeyed at once, lines are answered by ok or error:N.
Sources: gnea/grbl (bfb67f0) doc/markdown/{interface,jogging,commands,settings}.md: $10 bit 0 chooses MPos or WPos, $13
inches in reports, $22 homing (Alarm after each reset until $H or $X); grblHAL/core (f80fc34) report.c: its banner, and
sub-states of an alarm. Checked against the compiled grbl-sim and grblHAL simulator.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from softgrip_emulator.rig.plant import RigPlant

BAUD: Final = 115200
_MM: Final = 1e3
_BANNER: Final = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_HAL_BANNER: Final = b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
_MM_PER_INCH: Final = 25.4
#: [s] to the switches and back
_HOMING_S: Final = 4.0
#: as a new controller has them (settings.md)
_SETTINGS: Final = {10: 1.0, 13: 0.0, 20: 1.0, 21: 0.0, 22: 0.0, 100: 250.0, 101: 250.0, 102: 250.0}
_REALTIME: Final = re.compile(rb"[?!~\x18\x84\x85\x90-\x9d\xa0\xa1]")
_WORD: Final = re.compile(rb"([A-Z])(-?\d+(?:\.\d+)?)")
_OFFSET_EVERY: Final = 10


class EmulatedGrblStage:
    """The controller (a `WireDevice`).

    Args:
        plant: what it moves.
        soft_limits_mm: of machine position ($130, $20=1).
        settings: that differ from a new controller's.
        is_hal: it runs grblHAL.
        resets: times that opening the port resets it; 0: not at all, as over a cable without DTR.
    """

    def __init__(
        self,
        plant: RigPlant,
        soft_limits_mm: tuple[float, float] = (-200.0, 200.0),
        *,
        settings: Mapping[int, float] | None = None,
        is_hal: bool = False,
        resets: int = 1,
    ) -> None:
        self._plant = plant
        self._settings = _SETTINGS | dict(settings or {})
        self._banner = _HAL_BANNER if is_hal else _BANNER
        self._is_hal = is_hal
        self._resets = resets
        #: Work position less machine position [mm] (G54).
        self.offset_mm = 0.0
        self._limits_mm = soft_limits_mm
        self._buffer = b""
        self._reports = 0
        self.homings = 0
        #: Set to lock it until $X.
        self.alarm = self._wants_homing
        #: A limit switch was hit: nothing but a reset is heard (grbl/protocol.c, EXEC_ALARM_HARD_LIMIT).
        self.needs_reset = False
        #: No answer at all. reply_cut: replies lose their second half.
        self.silent = False
        self.reply_cut = False

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """DTR resets the Arduino; a reset in motion loses the position."""
        if self.silent:
            return []
        return [Chunk(self._reset(now_s), now_s + 0.08 * number) for number in range(self._resets)]

    def due_s(self) -> float | None:
        """GRBL speaks when spoken to (alarms aside)."""
        return None

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Real-time bytes and lines to replies."""
        if self.silent or baud != BAUD:
            return []
        out, homings = b"", self.homings
        with self._plant.lock:
            self._plant.advance(now_s)
            for byte in _REALTIME.findall(data):
                out += self._realtime(byte, now_s)
            if self.needs_reset:
                return [Chunk(out, now_s)] if out else []
            self._buffer += _REALTIME.sub(b"", data)
            *lines, self._buffer = re.split(rb"\r\n|\r|\n", self._buffer)
            for line in lines:
                # An empty line is answered, too: "for syncing purposes" (protocol.c).
                out += self._line(line.replace(b" ", b"").upper()) if line else b"ok\r\n"
        if self.reply_cut and out:
            out = out[: max(1, len(out) // 2)]
        # Nothing is said until it has come back from its switches.
        start_s = now_s + _HOMING_S if self.homings > homings else now_s
        return [Chunk(out, start_s)] if out else []

    # -- real time -------------------------------------------------------------------------------------------------

    def _realtime(self, byte: bytes, now_s: float) -> bytes:
        if byte == b"\x18":
            return self._reset(now_s)
        if byte == b"?":
            return b"" if self.needs_reset else self._report()
        if byte in {b"!", b"\x85", b"\x84"}:
            # A hold of a jog cancels it, too (jogging.md).
            self._plant.stop()
        return b""

    def _reset(self, now_s: float) -> bytes:
        with self._plant.lock:
            self._plant.advance(now_s)
            in_motion = self._plant.velocity != 0.0
            self._plant.stop()
            self._buffer = b""
            self.needs_reset = False
            self.alarm = self.alarm or in_motion or self._wants_homing
            alarm = b"ALARM:3\r\n" if in_motion else b""
            return alarm + self._banner + (b"[MSG:'$H'|'$X' to unlock]\r\n" if self.alarm else b"")

    @property
    def _wants_homing(self) -> bool:
        """Locked until homed: GRBL where $22 is on, grblHAL where its bit 4 is (and $X is refused then)."""
        return bool(int(self._settings[22]) & (4 if self._is_hal else 1))

    @property
    def _state(self) -> bytes:
        if self.alarm:
            return b"Alarm:11" if self._is_hal else b"Alarm"
        return b"Jog" if self._plant.velocity else b"Idle"

    def _report(self) -> bytes:
        self._reports += 1
        machine_mm = self._plant.travel * _MM
        if int(self._settings[10]) & 1:
            fields = [self._state, b"MPos:" + self._coordinates(machine_mm), b"Bf:15,128"]
        else:
            fields = [self._state, b"WPos:" + self._coordinates(machine_mm - self.offset_mm), b"Bf:15,128"]
        fields.append(b"FS:%d,0" % round(abs(self._plant.velocity) * 60.0 * _MM))
        if self._reports % _OFFSET_EVERY == 1:
            fields.append(b"WCO:" + self._coordinates(self.offset_mm))
        return b"<" + b"|".join(fields) + b">\r\n"

    def _coordinates(self, x_mm: float) -> bytes:
        if self._settings[13]:
            return b"%.4f,0.0000,0.0000" % (x_mm / _MM_PER_INCH)
        return b"%.3f,0.000,0.000" % x_mm

    # -- lines -----------------------------------------------------------------------------------------------------

    def _line(self, line: bytes) -> bytes:
        if line == b"$X":
            if self._is_hal and self.alarm and self._wants_homing:
                return b"error:46\r\n"
            self.alarm = False
            return b"[MSG:Caution: Unlocked]\r\nok\r\n"
        if line in {b"$I", b"$$"}:
            return self._reported(line)
        if line == b"$H":
            return self._home()
        if line.startswith(b"$J="):
            return self._jog(line[3:])
        error = b"3" if line.startswith(b"$") else b"9" if self.alarm else self._modal_error(line)
        return b"error:%s\r\n" % error if error else b"ok\r\n"

    def _reported(self, line: bytes) -> bytes:
        """Its version, or its settings."""
        if line == b"$I":
            if self._is_hal:
                return b"[VER:1.1f.20260817:]\r\n[OPT:VL,100,1024,3,0]\r\n[FIRMWARE:grblHAL]\r\nok\r\n"
            return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        return b"".join(b"$%d=%g\r\n" % pair for pair in self._settings.items()) + b"ok\r\n"

    def _home(self) -> bytes:
        if not self._settings[22]:
            return b"error:5\r\n"
        self.homings += 1
        self.alarm = False
        return b"ok\r\n"

    @staticmethod
    def _modal_error(line: bytes) -> bytes:
        words = _WORD.findall(line)
        if b"".join(letter + number for letter, number in words) != line:
            return b"2"
        known = {b"G21", b"G90", b"G91", b"G53", b"G4", b"G20"}
        return b"" if all(letter != b"G" or letter + number in known for letter, number in words) else b"20"

    def _jog(self, line: bytes) -> bytes:
        if self.alarm:
            return b"error:9\r\n"
        words = dict.fromkeys(letter + number for letter, number in _WORD.findall(line))
        values = {word[:1]: float(word[1:]) for word in words if word[:1] in b"XF"}
        if b"".join(words) != line or b"X" not in values:
            return b"error:16\r\n"
        if not values.get(b"F"):
            return b"error:22\r\n"
        scale = 25.4 if b"G20" in words else 1.0
        target_mm = values[b"X"] * scale + (self._plant.travel * _MM if b"G91" in words else 0.0)
        if not self._limits_mm[0] <= target_mm <= self._limits_mm[1]:
            return b"error:15\r\n"
        self._plant.move(target_mm / _MM, values[b"F"] * scale / _MM / 60.0)
        return b"ok\r\n"
