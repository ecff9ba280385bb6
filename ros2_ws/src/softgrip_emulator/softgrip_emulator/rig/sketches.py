# SPDX-License-Identifier: Apache-2.0
"""Boards with an HX711 that run the examples of its libraries: what they say from reset on, and when.

Each sketch is described from its published source: the speed of Serial.begin, what setup() prints and how many
conversions it averages before, what loop() prints, how many conversions that takes and how long it then waits. An
HX711 makes 10 or 80 conversions a second (Avia data sheet, pin RATE) by a clock of its own, which is quicker than that.
Opening the port of an Uno resets it (DTR), and its boot loader waits for a new sketch first.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from softgrip_emulator.rig.amplifier import counts_of
from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softgrip_emulator.rig.sensor import LoadCell

_GRAVITY: Final = 9.81
_POUND_N: Final = 4.4482216
#: a chip's own clock, in data sheet's: olkal/HX711_ADC issues 29, 80, 98 show 92, 11.67 and 93.7 conversions a second
CLOCK_RATIO: Final = 1.16
#: what the emulated cell shows without a load
OFFSET_COUNTS: Final = 84217.0


@dataclass(frozen=True)
class Sketch:
    """What a sketch says.

    Attributes:
        source: repository, commit and file.
        baud: of Serial.begin.
        setup: what setup() prints: text, conversions and delay [s] before it.
        settle: conversions and delay [s] between the last of these and loop().
        show: force [N] (tare taken out) and raw counts to what loop() prints.
        conversions, delay_s: of one turn of loop().
        tares: setup() takes the force that it meets for nothing.
    """

    source: str
    baud: int
    setup: tuple[tuple[str, int, float], ...]
    settle: tuple[int, float]
    show: Callable[[float, int], str]
    conversions: int
    delay_s: float
    tares: bool = False


_BOGDE = "bogde/HX711 be5e3d2 examples/"
_OLKAL = "olkal/HX711_ADC 7762bc4 examples/"
_SPARKFUN = "sparkfun/HX711-Load-Cell-Amplifier 38228f8 firmware/"
#: olkal: src/config.h averages 16 samples and leaves the highest and the lowest out
_OLKAL_TARE: Final = 18


def _grams(force: float) -> float:
    return 1e3 * force / _GRAVITY


def _bogde_setup() -> tuple[tuple[str, int, float], ...]:
    """Return what its setup() prints: read() and read_average() show the tare, get_value() and get_units() do not."""
    raw = f"{OFFSET_COUNTS:.0f}"
    before = (("read: \t\t", raw, 1), ("read average: \t\t", raw, 20), ("get value: \t\t", f"{raw}.00", 5))
    after = (*before[:2], ("get value: \t\t", "0.00", 5))
    lines = [("HX711 Demo", 0, 0.0), ("Initializing the scale", 0, 0.0), ("Before setting up the scale:", 0, 0.0)]
    lines += [(text + shown, conversions, 0.0) for text, shown, conversions in before]
    lines += [(f"get units: \t\t{raw}.0", 5, 0.0), ("After setting up the scale:", 10, 0.0)]
    lines += [(text + shown, conversions, 0.0) for text, shown, conversions in after]
    return (*lines, ("get units: \t\t0.0", 5, 0.0), ("Readings:", 0, 0.0))


SKETCHES: Final[dict[str, Sketch]] = {
    "bogde_basic": Sketch(
        _BOGDE + "HX711_basic_example", 57600, (), (0, 0.0), lambda _, raw: f"HX711 reading: {raw}", 1, 1.0
    ),
    "bogde_no_delay": Sketch(
        _BOGDE + "HX711_basic_example, delay(1000) taken out", 57600, (), (0, 0.0),
        lambda _, raw: f"HX711 reading: {raw}", 1, 0.0,
    ),
    "bogde_retry": Sketch(
        _BOGDE + "HX711_retry_example", 57600, (), (0, 0.0), lambda _, raw: f"HX711 reading: {raw}", 1, 1.5
    ),
    "bogde_timeout": Sketch(
        _BOGDE + "HX711_timeout_example", 57600, (), (0, 0.0), lambda _, raw: f"HX711 reading: {raw}", 1, 1.5
    ),
    "bogde_full": Sketch(
        _BOGDE + "HX711_full_example", 38400, _bogde_setup(), (0, 0.0),
        lambda force, _: f"one reading:\t{_grams(force):.1f}\t| average:\t{_grams(force):.1f}", 11, 5.0, tares=True,
    ),
    "olkal_read": Sketch(
        _OLKAL + "Read_1x_load_cell", 57600,
        (("", 0, 0.01), ("Starting...", 0, 0.0), ("Startup is complete", _OLKAL_TARE, 2.0)), (0, 0.0),
        lambda force, _: f"Load_cell output val: {_grams(force):.2f}", 1, 0.0, tares=True,
    ),
    "olkal_zero": Sketch(
        _OLKAL + "Persistent_zero_offset", 57600,
        (("", 0, 0.01), ("Starting...", 0, 0.0), ("Startup is complete", 0, 2.0)), (0, 0.0),
        lambda force, _: f"Load_cell output val: {_grams(force):.2f}", 1, 0.25,
    ),
    "tillaart_plotter": Sketch(
        "RobTillaart/HX711 fac13f0 examples/HX711_plotter", 115200, (), (10, 0.0),
        lambda force, _: f"{_grams(force):.2f}", 5, 0.25, tares=True,
    ),
    "sparkfun": Sketch(
        _SPARKFUN + "SparkFun_HX711_Example", 9600, (("HX711 scale demo", 0, 0.0), ("Readings:", 10, 0.0)), (0, 0.0),
        lambda force, _: f"Reading: {force / _POUND_N:.1f} lbs", 1, 0.0, tares=True,
    ),
    "sparkfun_zero": Sketch(
        _SPARKFUN + "SparkFun_HX711_KnownZeroStartup", 9600,
        (("Demo of zeroing out a scale from a known value", 0, 0.0), ("Readings:", 0, 0.0)), (0, 0.0),
        lambda force, _: f"Reading: {force / _POUND_N:.1f} lbs", 1, 0.0,
    ),
    "sparkfun_calibration": Sketch(
        _SPARKFUN + "SparkFun_HX711_Calibration", 9600,
        (
            ("HX711 calibration sketch", 0, 0.0), ("Remove all weight from scale", 0, 0.0),
            ("After readings begin, place known weight on scale", 0, 0.0),
            ("Press + or a to increase calibration factor", 0, 0.0),
            ("Press - or z to decrease calibration factor", 0, 0.0), (f"Zero factor: {OFFSET_COUNTS:.0f}", 20, 0.0),
        ),
        (0, 0.0), lambda force, _: f"Reading: {force / _POUND_N:.1f} lbs calibration_factor: -7050.00", 1, 0.0,
        tares=True,
    ),
}  # fmt: skip


class EmulatedBoard:
    """A board that runs a sketch (a `WireDevice`).

    Args:
        cell: its load cell.
        sketch: of `SKETCHES`.
        rate_hz: conversions a second by the data sheet, 10 or 80.
        boot_s: from the reset that opening the port is to setup().
    """

    def __init__(self, cell: LoadCell, sketch: str, rate_hz: float = 10.0, boot_s: float = 1.6) -> None:
        self._cell = cell
        self._sketch = SKETCHES[sketch]
        self._rate_hz = rate_hz
        self._boot_s = boot_s
        self._said: deque[tuple[float, str]] = deque()
        self._next_s: float | None = None
        self._tare: float | None = None
        #: Nothing comes any more. noisy: noise among the lines. reply_cut: lines lose their second half.
        self.silent = False
        self.noisy = False
        self.reply_cut = False
        self.resets = 0

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """DTR resets it."""
        self.reset(now_s, self._boot_s)
        return []

    def reset(self, now_s: float, boot_s: float) -> None:
        """Start again, as with DTR, the button, or a supply that sagged: silent for a time [s], then setup()."""
        self.resets += 1
        self._said.clear()
        self._tare = None
        due = now_s + boot_s
        for text, conversions, delay_s in self._sketch.setup:
            due += self._converting_s(conversions) + delay_s
            self._said.append((due, text))
            due += self._wire_s(text)
        conversions, delay_s = self._sketch.settle
        self._next_s = due + self._converting_s(conversions + self._sketch.conversions) + delay_s

    def due_s(self) -> float | None:
        """When the next line goes out [s]."""
        if self.silent:
            return None
        return self._said[0][0] if self._said else self._next_s

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:  # noqa: ARG002  it does not listen
        """The lines that are due; what the host says is ignored."""
        out = []
        while (due := self.due_s()) is not None and due <= now_s:
            text = self._said.popleft()[1] if self._said else self._shown(now_s)
            line = text.encode("ascii") + b"\r\n" if baud == self._sketch.baud else b"\xfe\x00\x86"
            line = line[: len(line) // 2] if self.reply_cut else line
            out.append(Chunk(b"\xff#" + line if self.noisy else line, now_s))
        return out

    def _shown(self, now_s: float) -> str:
        force = self._cell.read(now_s)
        raw = counts_of(force, OFFSET_COUNTS)
        if self._tare is None:
            # The last thing before loop() that takes a force: between the two nothing can be seen of it.
            self._tare = force if self._sketch.tares and math.isfinite(force) else 0.0
        text = self._sketch.show(force - self._tare, raw)
        period_s = max(self._converting_s(self._sketch.conversions) + self._sketch.delay_s, self._wire_s(text))
        self._next_s = max((self._next_s or now_s) + period_s, now_s)
        return text

    def _converting_s(self, conversions: int) -> float:
        """[s] that so many conversions take."""
        return conversions / (CLOCK_RATIO * self._rate_hz)

    def _wire_s(self, text: str) -> float:
        """[s] that a line is on the wire: Serial.print waits while its buffer is full."""
        return (len(text) + 2) * BITS_PER_BYTE / self._sketch.baud
