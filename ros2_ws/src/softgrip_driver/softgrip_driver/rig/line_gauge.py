# SPDX-License-Identifier: Apache-2.0
"""A gauge that speaks in lines, unasked (HX711 on an Arduino, OpenScale, a scale) or when asked, as a gauge.

Opening the port resets most boards (DTR). They boot, print a banner and tare themselves before the first line that
holds a value: 0.5 to 9 s. The newest whole line counts; what came before is thrown away.

A board that does so later, because its supply sagged or somebody pressed its button, takes the force of that moment for
nothing. So a banner, or a silence as long as the shortest boot, is an error of its own.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, GaugeRestartedError, NoReplyError
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.line_format import LineFormat, formats_of
from softgrip_driver.rig.line_port import LinePort

#: [s] from opening the port to the first value: Arduino's boot loader 1.6, and HX711_full_example of bogde/HX711
#: averages 71 samples at 10 a second before it begins.
BOOT_TIMEOUT_S = 12.0
#: [s] between lines beyond which what pulls would be too far before it is seen.
MAX_LINE_PERIOD_S = 2.0
#: Lines of another known format after which it is plain that the wrong one is configured.
FOREIGN_LINES = 3
#: Identical counts in a row that no real converter gives. A display in grams or newtons rounds them away.
STUCK_AFTER = 40
#: [s] of silence that may have been a boot, the shortest of the boards above
MIN_BOOT_S = 0.5
_TARE_READINGS = 8
#: [s] of silence before a gauge is asked again while it boots
_ASK_PERIOD_S = 0.5
_MAY_HAVE_RESTARTED = "; its board may have restarted, and tared itself under load"
#: a line is late when it takes so many times what the first took
_TIMEOUT_FACTOR = 2.5


@dataclass(frozen=True)
class GaugeScale:
    """From what a line shows (counts, or newtons as the gauge thinks) to newtons of pull.

    Attributes:
        counts_per_newton: its sign is that of pulling. offset_counts: shown with nothing hung.
    """

    counts_per_newton: float = 1.0
    offset_counts: float = 0.0

    def to_newtons(self, counts: float) -> float:
        """Return the tension [N]."""
        return (counts - self.offset_counts) / self.counts_per_newton


class Silence:
    """How long somebody who kept asking heard nothing."""

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._asked_s = 0.0

    def heard_nothing(self, began_s: float, now_s: float) -> None:
        """Take a question of [s] that was not answered until now [s]."""
        if self._began_s is None or began_s - self._asked_s > MIN_BOOT_S:
            # Nobody asked meanwhile: whether it was silent is not known.
            self._began_s = began_s
        self._asked_s = now_s

    def ended(self, began_s: float, now_s: float) -> float:
        """Return for how long [s] it was silent before an answer now [s] to a question of [s]."""
        silent_since, self._began_s = self._began_s, None
        return 0.0 if silent_since is None or began_s - self._asked_s > MIN_BOOT_S else now_s - silent_since


class LineGauge:
    """The gauge.

    Args:
        port: its serial port.
        line: how to ask for its lines and to read them.
        scale: of what they show.
    """

    def __init__(self, port: LinePort, line: LineFormat, scale: GaugeScale | None = None) -> None:
        self._port = port
        self._line = line
        self._scale = scale or GaugeScale()
        self._zero = 0.0
        self._timeout = port.reply_time
        self._last: deque[float] = deque(maxlen=STUCK_AFTER)
        self._silence = Silence()

    def open(self) -> DeviceIdentity:
        """Connect, wait until it has booted, and check that its lines can be read and come often enough.

        Raises:
            NoReplyError: nothing comes. CorruptReplyError: lines come that it can not read; says what fits them.
            DeviceRefusedError: they come too seldom. SaturatedError: the cell is cut, or overloaded.
        """
        self._port.open()
        self._last.clear()
        self._silence = Silence()
        self._zero = 0.0
        self._await_first_value()
        began = self._port.clock.now_s()
        try:
            self._line.parse(self._next_line(MAX_LINE_PERIOD_S))
        except NoReplyError as error:
            raise DeviceRefusedError(
                f"port {self._port.path}: expected a line every {MAX_LINE_PERIOD_S:g} s, found a longer pause; "
                "what pulls would be seen too late: take the delay out of the sketch",
                0,
            ) from error
        self._timeout = max(self._port.reply_time, _TIMEOUT_FACTOR * (self._port.clock.now_s() - began))
        return DeviceIdentity("gauge that answers" if self._line.request else "streaming gauge")

    def tare(self) -> None:
        """Make the present force zero (kept here: most of these devices cannot)."""
        self._zero = 0.0
        self._zero = statistics.fmean(self.tension() for _ in range(_TARE_READINGS))

    def counts(self) -> float:
        """Return what it shows now, in counts or newtons as the format has it: the first line that begins after this.

        Raises:
            CorruptReplyError: also when raw counts have no noise, which no converter's do.
            GaugeRestartedError: once, where it restarted since the last value.
        """
        counts = self._line.parse(self._heard_line())
        self._last.append(counts)
        if self._line.unit == "" and len(self._last) == STUCK_AFTER and len(set(self._last)) == 1:
            self._last.clear()
            raise CorruptReplyError(
                f"gauge: read {counts:g} {STUCK_AFTER} times without any noise: it is stuck; restart it"
            )
        return counts

    def tension(self) -> float:
        """Tension now [N]."""
        return self._scale.to_newtons(self.counts()) - self._zero

    def restore(self) -> None:
        """Nothing to set: it has no panel."""

    def close(self) -> None:
        """Disconnect."""
        self._port.close()

    def _heard_line(self) -> bytes:
        """Return the next line, unless it or the silence before it says that the board restarted."""
        clock, began = self._port.clock, self._port.clock.now_s()
        try:
            line = self._next_line(self._timeout)
        except NoReplyError:
            self._silence.heard_nothing(began, clock.now_s())
            raise
        # One line may be late without a boot.
        lasted = self._silence.ended(began, clock.now_s())
        if lasted >= max(MIN_BOOT_S, 2.0 * self._timeout):
            raise GaugeRestartedError(f"gauge: expected a line, found none for {lasted:.1f} s{_MAY_HAVE_RESTARTED}")
        if not self._line.request and _is_banner(line) and not self._line.matches(line):
            raise GaugeRestartedError(f"gauge: expected a value, found {line[:60]!r}{_MAY_HAVE_RESTARTED}")
        return line

    def _next_line(self, timeout: float) -> bytes:
        if not self._line.request:
            return self._port.read_next_line(timeout)
        self._port.drain()
        self._port.write(self._line.request)
        return self._port.read_line(timeout, length=self._line.length)

    def _await_first_value(self) -> None:
        """Read past a boot loader's noise, a banner and the lines of a tare."""
        end = self._port.clock.now_s() + BOOT_TIMEOUT_S
        unread, foreign = b"", 0
        while True:
            try:
                line = self._next_line(min(_ASK_PERIOD_S, BOOT_TIMEOUT_S))
                self._line.parse(line)
            except NoReplyError:
                if self._port.clock.now_s() >= end:
                    raise self._unreadable(unread) if unread else self._silent() from None
            except CorruptReplyError:
                unread = line or unread
                foreign += bool(formats_of(line))
                if foreign >= FOREIGN_LINES or self._port.clock.now_s() >= end:
                    raise self._unreadable(unread) from None
            else:
                return

    def _silent(self) -> NoReplyError:
        return NoReplyError(
            f"port {self._port.path}: expected a line within {BOOT_TIMEOUT_S:g} s of opening it, found nothing; check "
            "power, cable and baud rate"
        )

    def _unreadable(self, line: bytes) -> CorruptReplyError:
        fitting = formats_of(line)
        printable = line.decode("ascii", "replace").isprintable() and b"\xff" not in line and line.isascii()
        if fitting:
            remedy = f"set stream_line to {' or '.join(fitting)}"
        elif printable:
            remedy = "set stream_line to a pattern that fits"
        else:
            remedy = "this looks like another baud rate: set stream_baud"
        return CorruptReplyError(
            f"port {self._port.path}: expected a line like /{self._line.pattern}/, found {line[:60]!r}; {remedy}"
        )


def _is_banner(line: bytes) -> bool:
    """Whether a line is text, as a sketch's setup() prints it, and no noise or half a value."""
    text = line.decode("ascii", "replace")
    return text.isprintable() and "\ufffd" not in text and any(letter.isalpha() for letter in text)
