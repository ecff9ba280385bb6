# SPDX-License-Identifier: Apache-2.0
"""A load-cell amplifier that streams lines whether asked or not: HX711 on an Arduino, OpenScale, a scale."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softgrip_emulator.rig.sensor import LoadCell

#: Counts per newton of the raw formats: a 50 N cell at gain 128.
COUNTS_PER_NEWTON: Final = 80000.0
#: [N] Standard deviation of a board's readings. Users' scatter by 70 counts (roger-random.github.io, "Observations on
#: 24 Hours of HX711 Data": 350 within a minute) and by 110 (Arduino forum 351959); the greater.
HX711_NOISE_N: Final = 110.0 / COUNTS_PER_NEWTON
#: codes at the ends of an HX711's range (Avia data sheet)
_LOWEST_CODE, _HIGHEST_CODE = -8388608, 8388607
_GRAVITY: Final = 9.81


def counts_of(force: float, offset: float = 0.0) -> int:
    """Return an HX711's code for a force [N], with the cell's offset [counts]; the last code where its range ends."""
    return round(min(max(force * COUNTS_PER_NEWTON + offset, _LOWEST_CODE), _HIGHEST_CODE))


def _scale(force: float) -> str:
    if math.isinf(force):
        return "OL,GS,  -------kg"
    return f"ST,GS,{'-' if force < 0.0 else '+'}{abs(force) / _GRAVITY:7.4f}kg"


#: Format -> (force [N], time [s]) to a line.
FORMATS: dict[str, Callable[[float, float], str]] = {
    "raw": lambda force, _: f"{counts_of(force)}",
    "time_raw": lambda force, now: f"{round(now * 1e3)},{counts_of(force)}",
    "grams": lambda force, _: f"Reading: {1e3 * force / _GRAVITY:.2f} g",
    "newtons": lambda force, _: f"{force:.3f} N",
    "openscale": lambda force, now: f"{round(now * 1e3)},{force / _GRAVITY:.4f},kg,24.5,",
    "scale": lambda force, _: _scale(force),
}


#: Baud [1/s] and lines a second of those that are no sketch of one's own. OpenScale: sparkfun/OpenScale 061045a and
#: its hookup guide (a line every few hundred milliseconds); scales: KERN's come with 9600 baud; their rate is assumed.
WIRES: dict[str, tuple[int, float]] = {"openscale": (9600, 5.0), "scale": (9600, 10.0)}
#: of the others: assumption; an HX711 gives 10 or 80
_WIRE: Final = (115200, 80.0)


class EmulatedAmplifier:
    """The amplifier (a `WireDevice`).

    Args:
        cell: its load cell.
        line: one of `FORMATS`.
    """

    def __init__(self, cell: LoadCell, line: str = "grams") -> None:
        self._cell = cell
        self._line = FORMATS[line]
        self._baud, rate_hz = WIRES.get(line, _WIRE)
        self._period_s = 1.0 / rate_hz
        self._next_s: float | None = None
        #: Nothing comes any more. reply_cut: every line loses its second half, end included.
        self.silent = False
        self.reply_cut = False
        #: Noise among the lines.
        self.noisy = False

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """The stream is met in the middle of a line."""
        self._next_s = now_s + self._period_s
        line = self._text(now_s)
        return [] if self.silent else [Chunk(line[len(line) // 2 :], now_s)]

    def due_s(self) -> float | None:
        """When the next line goes out [s]."""
        return None if self.silent else self._next_s

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:  # noqa: ARG002  it does not listen
        """The next line when due; what the host says is ignored."""
        if self.silent or self._next_s is None or now_s < self._next_s:
            return []
        self._next_s = max(self._next_s + self._period_s, now_s)
        if baud != self._baud:
            return [Chunk(b"\xfe\x00\x86", now_s)]
        line = self._text(now_s)
        if self.reply_cut:
            line = line[: len(line) // 2]
        if self.noisy:
            line = b"\xff#" + line
        return [Chunk(line, now_s)]

    def _text(self, now_s: float) -> bytes:
        return self._line(self._cell.read(now_s), now_s).encode("ascii") + b"\r\n"
