# SPDX-License-Identifier: Apache-2.0
"""What gauges that speak in lines say: HX711 sketches, OpenScale, scales, and gauges that answer a command.

What a line looks like is configuration: a regular expression with a group ``value``, and optionally ``sign``, ``unit``
and ``status``. No port here: bytes in, a number out.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DeviceRefusedError,
    SaturatedError,
    UnitChangedError,
)
from softgrip_model.friction.laws import GRAVITY

#: HX711: the codes at which its 24-bit converter is at the end of its range.
RAW_ENDS = (8388607.0, -8388608.0)
#: [1/s] of a gauge whose documents name no other
DEFAULT_BAUD = 115200
_POUND = 4.4482216
#: [N] of one of each unit, as lines name them in any case; Imada's are single capitals
_UNITS = {
    "n": 1.0, "mn": 1e-3, "kn": 1e3, "g": GRAVITY * 1e-3, "gf": GRAVITY * 1e-3, "kg": GRAVITY, "kgf": GRAVITY,
    "lb": _POUND, "lbs": _POUND, "lbf": _POUND, "oz": _POUND / 16.0, "ozf": _POUND / 16.0, "O": _POUND, "K": GRAVITY,
}  # fmt: skip
#: unit of a format whose every line names its own
ANY_UNIT = "any"
_NUMBER = r"[+-]?\s*\d+(?:\.\d+)?"
_UNIT = r"(?i:[mk]?N|k?gf?|lb[fs]?|ozf?)"


@dataclass(frozen=True)
class LineFormat:
    """How to read a line, and how to ask for one.

    Attributes:
        pattern: with group ``value``; optional ``sign`` (0 is minus), ``unit`` (checked) and ``status``.
        unit: what the value is in, one of N, mN, g, kg, lb; `ANY_UNIT`: as the line says; empty: counts.
        overload: texts of group ``status`` that mean overload. refused: those that mean that no value can be had.
        request: what asks for a line; empty: it comes unasked.
        end: of a line. length: [byte] of an answer that has no end.
        baud: [1/s] that its documents name.
    """

    pattern: str
    unit: str = ""
    overload: tuple[str, ...] = ("OL",)
    refused: tuple[str, ...] = ()
    request: bytes = b""
    end: bytes = b"\n"
    length: int = 0
    baud: int = DEFAULT_BAUD

    def matches(self, line: bytes) -> bool:
        """Whether a line is one of this format, be it a value or not."""
        return re.fullmatch(self.pattern, line.decode("ascii", "replace").strip()) is not None

    def parse(self, line: bytes) -> float:
        """Return what a line shows: newtons, or counts where the format has no unit.

        Raises:
            CorruptReplyError: the line does not match. SaturatedError: overload, or the end of the converter's range.
            DeviceRefusedError: it can not measure now. UnitChangedError: another unit than configured.
        """
        match = re.fullmatch(self.pattern, line.decode("ascii", "replace").strip())
        if match is None:
            raise CorruptReplyError(f"gauge: expected a line like /{self.pattern}/, found {line[:60]!r}")
        groups = match.groupdict()
        status = groups.get("status")
        if status in self.overload:
            raise SaturatedError(f"gauge: overload ({line[:60]!r}); take weight off")
        if status in self.refused:
            raise DeviceRefusedError(f"gauge: expected a value, found {line[:60]!r}; see its display", 0)
        value = self._number(groups["value"], line) * (-1.0 if groups.get("sign") == "0" else 1.0)
        if self.unit == "" and value in RAW_ENDS:
            raise SaturatedError("gauge: the converter is at the end of its range; check the cell's wires and its load")
        return value * self._newtons(groups.get("unit"))

    def _newtons(self, unit: str | None) -> float:
        if self.unit == "":
            return 1.0
        if self.unit != ANY_UNIT and unit not in (None, self.unit):
            raise UnitChangedError(f"gauge: expected '{self.unit}', found '{unit}'; set its unit back")
        named = self.unit if unit is None else unit
        return _UNITS[named] if named in _UNITS else _UNITS[named.lower()]

    @staticmethod
    def _number(text: str | None, line: bytes) -> float:
        """A pattern, all the more one of a user's, may let through what is no number."""
        try:
            value = float((text or "").replace(" ", ""))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise CorruptReplyError(f"gauge: expected a number, found {text!r} in the line {line[:60]!r}")
        return value


#: Formats by name; a pattern may be given instead. Sources, and a documented line of each: test/test_gauge_lines.py;
#: imada: clients of the DST-44A and of sktometometo/imada_forcegauge (unit O, K, N; mode T, P; judgement L, O, H, E).
FORMATS = {
    "raw": LineFormat(rf"(?P<value>{_NUMBER})"),
    "time_raw": LineFormat(r"\d+,(?P<value>-?\d+)"),
    "grams": LineFormat(rf"(?:Reading:\s*)?(?P<value>{_NUMBER})\s*(?P<unit>g)", "g"),
    "newtons": LineFormat(rf"(?P<value>{_NUMBER})\s*(?P<unit>N)", "N"),
    "pounds": LineFormat(rf"(?:Reading:\s*)?(?P<value>{_NUMBER})\s*(?P<unit>lb)s?(?:\s.*)?", "lb", baud=9600),
    "hx711": LineFormat(r"HX711 reading:\s*(?P<value>-?\d+)", baud=57600),
    "hx711_full": LineFormat(rf"one reading:\s*(?P<value>{_NUMBER})\s*\|.*", baud=38400),
    "hx711_adc": LineFormat(rf"Load_cell output val:\s*(?P<value>{_NUMBER})", baud=57600),
    "openscale": LineFormat(rf"(?:\d+,)?(?P<value>{_NUMBER}),(?P<unit>{_UNIT})(?:,.*)?", ANY_UNIT, baud=9600),
    "scale": LineFormat(
        rf"(?:\d\d)?(?:(?P<status>OL|UL)\b.*|(?:ST|US),\s*(?:(?:GS|NT|G|N)\b\s*,?\s*)?(?P<value>{_NUMBER}),?\s*"
        rf"(?P<unit>{_UNIT}))", ANY_UNIT, overload=("OL", "UL"), baud=9600,
    ),
    "value_unit": LineFormat(
        rf"(?:(?:GROSS|NET|G|N)\s+)?(?P<value>{_NUMBER})\s*(?P<unit>{_UNIT})(?:\s*\?)?(?:\s+(?:G|NET))?", ANY_UNIT,
        baud=9600,
    ),
    "sauter": LineFormat(r"(?P<sign>[01])(?P<value>[\d.]{6})", "N", request=b"9", length=7, baud=9600),
    "andilog": LineFormat(
        rf"(?P<status>[?!])|(?P<value>{_NUMBER})(?:\t.*)?", "N", refused=("?", "!"), request=b"F", end=b"\r"
    ),
    "mt_sics": LineFormat(
        rf"S (?P<status>[SDI+-])(?:\s+(?P<value>{_NUMBER})\s+(?P<unit>g|kg|lb|N|mN))?", ANY_UNIT,
        overload=("+", "-"), refused=("I",), request=b"SI\r\n", baud=9600,
    ),
    "radwag": LineFormat(
        rf"(?:SI |SUI)(?:(?P<status>[?^vIEA])|\s)(?:\s+(?P<value>{_NUMBER}) (?P<unit>{_UNIT}))?", ANY_UNIT,
        overload=("^", "v"), refused=("I", "E", "A"), request=b"SI\r\n", baud=9600,
    ),
    "imada": LineFormat(
        r"(?P<value>[+-]\d+\.?\d*)(?P<unit>[OKN])[TP](?P<status>[LOHE])", ANY_UNIT,
        overload=("E",), request=b"D\r", end=b"\r", baud=19200,
    ),
    "tecsis": LineFormat(
        rf"(?P<status>ERR)|N\s*(?P<value>{_NUMBER})", refused=("ERR",), request=b"GN\r", end=b"\r", baud=9600
    ),
}  # fmt: skip


def line_format(name: str, request: bytes = b"") -> LineFormat:
    """Return a format by name, or one from a pattern (counts, or newtons where it has a group ``unit``).

    Args:
        name: of `FORMATS`, or a pattern.
        request: what asks for a line, in place of the format's own; empty: its own.

    Raises:
        ConfigurationError: neither a known name nor a pattern with a group ``value``.
    """
    if name in FORMATS:
        return replace(FORMATS[name], request=request or FORMATS[name].request)
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
    return LineFormat(name, "N" if "unit" in groups else "", request=request)


def formats_of(line: bytes) -> list[str]:
    """Return the names of the formats that a line fits."""
    fitting = []
    for name, known in FORMATS.items():
        try:
            known.parse(line)
        except (CorruptReplyError, UnitChangedError):
            continue
        except (SaturatedError, DeviceRefusedError):
            pass
        fitting.append(name)
    return fitting
