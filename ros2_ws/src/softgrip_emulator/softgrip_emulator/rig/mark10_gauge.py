# SPDX-License-Identifier: Apache-2.0
"""A Mark-10 Series 5/7 force gauge speaking GCL2, at the device end of its wire.

Commands end in CR (LF is ignored), replies in CRLF; setters answer nothing; *10 is an illegal command (Series 5
manual). Compression counts positive, tension negative, as the gauge ships.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from softgrip_emulator.rig.sensor import LoadCell

BAUD: Final = 115200
#: Unit -> (newtons per unit, text in a reading, decimals): a gauge of 50 N capacity shows 0.01 N.
_UNITS: Final = {
    "N": (1.0, "N", 2),
    "MN": (1e-3, "mN", 0),
    "KN": (1e3, "kN", 5),
    "LB": (4.4482216, "lbF", 3),
    "OZ": (0.27801385, "ozF", 2),
    "KG": (9.80665, "kgF", 4),
    "G": (0.00980665, "gF", 0),
}
_MODES: Final = ("CUR", "PT", "PC", "A")
_SETTERS: Final = ("FULL", "NUM", "POL", "SAVE", "CLR")


class EmulatedMark10Gauge:
    """The gauge (a `WireDevice`).

    Args:
        cell: its load cell.
    """

    def __init__(self, cell: LoadCell) -> None:
        self._cell = cell
        self._buffer = b""
        self._unit = "N"
        self._mode = "CUR"
        self._filter = 8
        self._auto_output_hz = 0
        self._next_output_s: float | None = None
        #: No answer at all. illegal: every command is answered by *10. battery: 0 full .. 3 low.
        self.silent = False
        self.illegal = False
        self.battery = 0
        #: Replies lose their second half.
        self.reply_cut = False

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """A gauge left in automatic output talks from the first moment."""
        self._buffer = b""
        self._schedule(now_s)
        return []

    def due_s(self) -> float | None:
        """When automatic output next sends [s]."""
        return None if self.silent else self._next_output_s

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Commands to replies, and automatic output when due."""
        if self.silent or baud != BAUD:
            return []
        out = b""
        if self._next_output_s is not None and now_s >= self._next_output_s:
            out += self._reading(now_s)
            self._schedule(now_s)
        self._buffer += data
        *lines, self._buffer = re.split(rb"\r\n?|\n", self._buffer)
        for line in lines:
            if line:
                out += self._obey(line.decode("ascii", "replace").strip().upper(), now_s)
        if self.reply_cut and out:
            out = out[: max(1, len(out) // 2)]
        return [Chunk(out, now_s)] if out else []

    def panel_unit(self, unit: str) -> None:
        """Somebody switches the unit at the panel."""
        self._unit = unit

    def panel_auto_output(self, rate_hz: int, now_s: float) -> None:
        """Somebody switches automatic output on: force lines nobody asked for."""
        self._auto_output_hz = rate_hz
        self._schedule(now_s)

    # -- commands --------------------------------------------------------------------------------------------------

    def _obey(self, command: str, now_s: float) -> bytes:
        if self.illegal:
            return b"*10\r\n"
        if command in {"?", "?C"}:
            return self._reading(now_s)
        if command in _UNITS:
            self._unit = command
        elif command in _MODES:
            self._mode = command
        elif command == "Z":
            self._cell.tare(now_s)
        elif command == "LIST":
            return self._list()
        elif command.startswith(("AOUT", "FLTC", "FLTP", "AOFF", "IPOL")):
            return self._numbered(command, now_s)
        elif command not in _SETTERS:
            return b"*10\r\n"
        return b""

    def _numbered(self, command: str, now_s: float) -> bytes:
        digits = command[4:]
        if not digits.isdigit():
            return b"*12\r\n"
        if command.startswith("AOUT"):
            if int(digits) > 250:
                return b"*22\r\n"
            self._auto_output_hz = int(digits)
            self._schedule(now_s)
        elif command.startswith("FLTC"):
            self._filter = int(digits)
        return b""

    def _schedule(self, now_s: float) -> None:
        self._next_output_s = now_s + 1.0 / self._auto_output_hz if self._auto_output_hz else None

    def _reading(self, now_s: float) -> bytes:
        newtons, text, decimals = _UNITS[self._unit]
        force = self._cell.read(now_s)
        if math.isinf(force):
            # Assumption: the display's overload text goes out instead of digits.
            return b"OVER\r\n"
        return f"{-force / newtons:.{decimals}f} {text}\r\n".encode("ascii")

    def _list(self) -> bytes:
        unit = _UNITS[self._unit][1].upper()
        return (
            f"V1.00;{unit};{self._mode};FLTC{self._filter};FLTP1;AOUT{self._auto_output_hz:02d};AOFF5;FULL;MIT;POL;"
            f"B{self.battery}\r\n"
        ).encode("ascii")
