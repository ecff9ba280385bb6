# SPDX-License-Identifier: Apache-2.0
"""A load-cell amplifier that streams lines (HX711 on an Arduino, OpenScale, a scale), as a gauge.

What a line looks like is configuration: a regular expression with a group ``value``, and optionally ``unit`` and
``status``. The newest whole line counts; what came before is thrown away.
"""

from __future__ import annotations

import math
import re
import statistics
from collections import deque
from dataclasses import dataclass

from softgrip_driver.errors import ConfigurationError, CorruptReplyError
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.errors import SaturatedError, UnitChangedError
from softgrip_driver.rig.line_port import LinePort
from softgrip_model.friction.laws import GRAVITY

#: HX711: the codes at which its 24-bit converter is at the end of its range.
RAW_ENDS = (8388607.0, -8388608.0)
#: Identical raw readings in a row that no real converter gives.
STUCK_AFTER = 40
_TARE_READINGS = 8
_UNITS = {"": 1.0, "N": 1.0, "mN": 1e-3, "g": GRAVITY * 1e-3, "kg": GRAVITY, "lb": 4.4482216}


@dataclass(frozen=True)
class LineFormat:
    """How to read a line.

    Attributes:
        pattern: with group ``value``; optional groups ``unit`` (checked) and ``status``.
        unit: what the value is in, one of N, mN, g, kg, lb, or empty for raw counts.
        counts_per_newton: of raw counts; ignored otherwise.
        overload: texts of group ``status`` that mean overload.
    """

    pattern: str
    unit: str = ""
    counts_per_newton: float = 1.0
    overload: tuple[str, ...] = ("OL",)

    def parse(self, line: bytes) -> float:
        """Return the force [N] that a line gives.

        Raises:
            CorruptReplyError: the line does not match. SaturatedError: overload, or the end of the converter's range.
            UnitChangedError: another unit than configured.
        """
        match = re.fullmatch(self.pattern, line.decode("ascii", "replace").strip())
        if match is None:
            raise CorruptReplyError(f"amplifier: expected a line like /{self.pattern}/, found {line[:60]!r}")
        groups = match.groupdict()
        if groups.get("status") in self.overload:
            raise SaturatedError(f"amplifier: overload ({line[:60]!r}); take weight off")
        unit = groups.get("unit")
        if unit is not None and unit != self.unit:
            raise UnitChangedError(f"amplifier: expected '{self.unit}', found '{unit}'; set its unit back")
        value = self._number(groups["value"], line)
        if self.unit == "" and value in RAW_ENDS:
            raise SaturatedError("amplifier: the converter is at the end of its range; check wiring and load")
        return value * _UNITS[self.unit] / (self.counts_per_newton if self.unit == "" else 1.0)

    @staticmethod
    def _number(text: str | None, line: bytes) -> float:
        """A pattern, all the more one of a user's, may let through what is no number."""
        try:
            value = float((text or "").replace(" ", ""))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise CorruptReplyError(f"amplifier: expected a number, found {text!r} in the line {line[:60]!r}")
        return value


#: Formats by name; a custom pattern may be given instead.
FORMATS = {
    "raw": LineFormat(r"(?P<value>-?\d+)"),
    "time_raw": LineFormat(r"\d+,(?P<value>-?\d+)"),
    "grams": LineFormat(r"(?:Reading:\s*)?(?P<value>-?\d+(?:\.\d+)?)\s*(?P<unit>g)", "g"),
    "newtons": LineFormat(r"(?P<value>-?\d+(?:\.\d+)?)\s*(?P<unit>N)", "N"),
    "openscale": LineFormat(r"\d+,(?P<value>-?\d+(?:\.\d+)?),(?P<unit>kg|lb),.*", "kg"),
    "scale": LineFormat(
        r"(?P<status>OL),.*|(?:ST|US),(?:GS|NT),\s*(?P<value>[+-]?\s*\d+(?:\.\d+)?)\s*(?P<unit>kg|g)", "kg"
    ),
}


def line_format(name: str, counts_per_newton: float = 1.0) -> LineFormat:
    """Return a format by name, or one from a pattern (raw counts, or newtons where it has a group ``unit``).

    Raises:
        ConfigurationError: neither a known name nor a pattern with a group ``value``.
    """
    if name in FORMATS:
        known = FORMATS[name]
        return LineFormat(known.pattern, known.unit, counts_per_newton, known.overload)
    try:
        groups = re.compile(name).groupindex
    except re.error as error:
        raise ConfigurationError(
            f"line format: expected one of {', '.join(FORMATS)} or a regular expression, found '{name}': {error}"
        ) from error
    if "value" not in groups:
        raise ConfigurationError(
            f"line format: expected one of {', '.join(FORMATS)} or a pattern with (?P<value>...), found '{name}'"
        )
    return LineFormat(name, "N" if "unit" in groups else "", counts_per_newton)


class StreamAmplifier:
    """The amplifier.

    Args:
        port: its serial port.
        line: how to read its lines.
        sign: 1 when pulling counts positive, -1 otherwise.
    """

    def __init__(self, port: LinePort, line: LineFormat, sign: float = 1.0) -> None:
        self._port = port
        self._line = line
        self._sign = sign
        self._zero = 0.0
        self._last: deque[bytes] = deque(maxlen=STUCK_AFTER)

    def open(self) -> DeviceIdentity:
        """Connect and check that its lines can be read."""
        self._port.open()
        self._last.clear()
        self._port.read_line(self._port.reply_time * 4)
        self.tension()
        return DeviceIdentity("streaming amplifier")

    def tare(self) -> None:
        """Make the present force zero (kept here: most of these devices cannot)."""
        self._zero = 0.0
        self._zero = statistics.fmean(self.tension() for _ in range(_TARE_READINGS))

    def tension(self) -> float:
        """Tension now [N]: the first line that begins after this call."""
        if self._port.drain():
            # Where the wire was cut into is unknown: the rest of that line may look like a whole one.
            self._port.read_line()
        line = self._port.read_line()
        force = self._sign * self._line.parse(line)
        self._last.append(line)
        if len(self._last) == STUCK_AFTER and len({self._value_of(text) for text in self._last}) == 1:
            self._last.clear()
            raise CorruptReplyError(
                f"amplifier: read {line[:40]!r} {STUCK_AFTER} times without any noise: it is stuck; restart it"
            )
        return force - self._zero

    def restore(self) -> None:
        """Nothing to set: it has no panel."""

    def close(self) -> None:
        """Disconnect."""
        self._port.close()

    def _value_of(self, line: bytes) -> str:
        match = re.fullmatch(self._line.pattern, line.decode("ascii", "replace").strip())
        return (match["value"] or "") if match else ""
