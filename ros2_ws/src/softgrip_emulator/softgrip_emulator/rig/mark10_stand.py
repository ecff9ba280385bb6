# SPDX-License-Identifier: Apache-2.0
"""A Mark-10 ESM test stand under PC control, at the device end of its wire.

Single lower-case letters without a terminator; set commands carry a fixed number of digits (ESM303 manual, "PC
control"). Where the manual leaves the exact reply open, the form is marked as an assumption.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softgrip_emulator.rig.plant import RigPlant
    from softgrip_emulator.rig.sensor import LoadCell

BAUD: Final = 115200
_MM: Final = 1e3
_MM_PER_INCH: Final = 25.4
_MAX_SPEED_MM_MIN: Final = 1100.0
_MIN_SPEED_MM_MIN: Final = 0.5
_COMMAND = re.compile(
    rb"(?P<speed>e(?:\d{4}\.\d|\d\d\.\d\d))|(?P<limit>[gh]-?(?:\d{3}\.\d\d|\d\d\.\d{3}))|(?P<cycles>f\d{4})"
    rb"|(?P<plain>[a-z])"
)
_INCOMPLETE = re.compile(rb"[efgh][-\d.]*$")
#: What PC control off leaves working (manual: data requests).
_DATA_COMMANDS: Final = b"anxzpvwoqr"


class EmulatedMark10Stand:
    """The stand (a `WireDevice`); its gauge port is wired to the load cell, as `n` needs.

    Args:
        plant: what it moves.
        cell: what hangs on it.
    """

    def __init__(self, plant: RigPlant, cell: LoadCell) -> None:
        self._plant = plant
        self._cell = cell
        self._buffer = b""
        self._speed_mm_min = 40.0
        self._lower_mm, self._upper_mm = -999.0, 999.0
        self._limit_mode = False
        self._inch = False
        self._zero = 0.0
        #: False after Auto Return or Cycling was pressed at the panel: motion commands are ignored.
        self.pc_control = True
        #: No answer at all: power off, or a cable that is not there.
        self.silent = False
        #: Replies lose their second half.
        self.reply_cut = False

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """The stand does not care who opens the port."""
        self._plant.advance(now_s)
        self._buffer = b""
        return []

    def due_s(self) -> float | None:
        """The stand speaks only when spoken to."""
        return None

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Commands to replies."""
        if self.silent or baud != BAUD:
            return []
        with self._plant.lock:
            self._plant.advance(now_s)
            self._buffer += data
            out = b""
            while self._buffer:
                match = _COMMAND.match(self._buffer)
                incomplete = _INCOMPLETE.fullmatch(self._buffer)
                if incomplete and not (match and match.lastgroup != "plain"):
                    break
                taken = match[0] if match else self._buffer[:1]
                self._buffer = self._buffer[len(taken) :]
                if match:
                    out += self._obey(taken, now_s)
        if self.reply_cut and out:
            out = out[: max(1, len(out) // 2)]
        return [Chunk(out, now_s)] if out else []

    def panel_auto_return(self) -> None:
        """Somebody presses Auto Return: the stand leaves PC control without a word."""
        with self._plant.lock:
            self.pc_control = False
            self._plant.stop()

    # -- commands --------------------------------------------------------------------------------------------------

    def _obey(self, command: bytes, now_s: float) -> bytes:
        letter, argument = command[:1], command[1:]
        if not self.pc_control and letter not in _DATA_COMMANDS:
            return b""
        if argument:
            self._set(letter, argument)
            return b""
        return self._plain(letter, now_s)

    def _set(self, letter: bytes, argument: bytes) -> None:
        """Set a speed or limit; one written with the digits of the other unit is not understood."""
        value, decimals = float(argument), len(argument.rpartition(b".")[2])
        if letter != b"f" and decimals != (1 if letter == b"e" else 2) + self._inch:
            return
        value *= _MM_PER_INCH if self._inch else 1.0
        if letter == b"e" and _MIN_SPEED_MM_MIN <= value <= _MAX_SPEED_MM_MIN:
            self._speed_mm_min = value
        elif letter == b"g":
            self._lower_mm = value
        elif letter == b"h":
            self._upper_mm = value

    def _plain(self, letter: bytes, now_s: float) -> bytes:
        if letter in b"uds":
            self._move(letter)
        elif letter in b"lmc":
            self._limit_mode = letter == b"l"
        elif letter in b"bi":
            self._inch = letter == b"b"
        elif letter in b"jk":
            # "Set crosshead speed to maximum, minimum speed" (ESM301 user's guide, 6.2).
            self._speed_mm_min = _MAX_SPEED_MM_MIN if letter == b"j" else _MIN_SPEED_MM_MIN
        elif letter == b"z":
            self._zero = self._plant.travel
        replies: dict[bytes, Callable[[], bytes]] = {
            b"n": lambda: self._force_text(now_s) + self._length(self._travel_mm),
            b"x": lambda: self._length(self._travel_mm),
            b"p": self._status,
            b"a": lambda: b"%.1f mm/min\r\n" % self._speed_mm_min,
            b"o": lambda: b"%.1f mm/min\r\n" % self._speed_mm_min,
            b"v": lambda: self._length(self._upper_mm),
            b"w": lambda: self._length(self._lower_mm),
        }
        reply = replies.get(letter)
        return reply() if reply else b""

    @property
    def _travel_mm(self) -> float:
        return (self._plant.travel - self._zero) * _MM

    def _move(self, letter: bytes) -> None:
        if letter == b"s":
            self._plant.stop()
            return
        up = letter == b"u"
        limit = self._upper_mm if up else self._lower_mm
        target_mm = limit if self._limit_mode else (999.0 if up else -999.0)
        if (target_mm > self._travel_mm) == up:
            self._plant.move(target_mm / _MM + self._zero, self._speed_mm_min / _MM / 60.0)

    def _length(self, millimetres: float) -> bytes:
        return b"%.3f in\r\n" % (millimetres / _MM_PER_INCH) if self._inch else b"%.2f mm\r\n" % millimetres

    def _force_text(self, now_s: float) -> bytes:
        return b"%.2f N\r\n" % -self._cell.read(now_s)

    def _status(self) -> bytes:
        # Assumption: the movement alone. The manual gives codes of movement and of mode; LabKit takes one alone.
        velocity = self._plant.velocity
        if velocity:
            return b"U\r\n" if velocity > 0.0 else b"D\r\n"
        if self._limit_mode and self._travel_mm >= self._upper_mm - 0.01:
            return b"UL\r\n"
        if self._limit_mode and self._travel_mm <= self._lower_mm + 0.01:
            return b"DL\r\n"
        return b"S\r\n"
