# SPDX-License-Identifier: Apache-2.0
"""The words of Mark-10 stands (PC control) and gauges (GCL2), without any port: bytes in, values out.

Sources: ESM303 and Series 5/7 user's guides. The stand takes single lower-case letters without a terminator, in
millimetres after ``i``; the gauge takes words that end in CR and answers in CRLF.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, SaturatedError

BAUD = 115200

# -- stand --
UP, DOWN, STOP, MAX_SPEED = b"u", b"d", b"s", b"j"
MILLIMETRES, LIMIT_MODE, ZERO_TRAVEL = b"i", b"l", b"z"
REQUEST_TRAVEL, REQUEST_STATUS, REQUEST_SPEED = b"x", b"p", b"a"
REQUEST_UPPER, REQUEST_LOWER = b"v", b"w"
#: [mm] what g and h can express.
LONGEST_TRAVEL_MM = 999.99
_LENGTH = re.compile(rb"\s*([-+]?\d+(?:\.\d+)?)\s*(mm|in)\s*")
_NUMBER = re.compile(rb"\s*([-+]?\d+(?:\.\d+)?)\b.*")

# -- gauge --
_READING = re.compile(r"\s*([-+]?\d+(?:\.\d+)?)\s*([A-Za-z]+)?\s*")
_ERRORS = {"*10": "illegal command", "*11": "not applicable", "*12": "invalid specifier", "*22": "number too large"}
_UNIT_NAMES = {"N": "N", "MN": "mN", "KN": "kN", "LBF": "lbF", "OZF": "ozF", "KGF": "kgF", "GF": "gF"}


def speed_command(speed_mm_min: float) -> bytes:
    """Return ``eXXXX.X``.

    Raises:
        ValueError: outside 0.1 .. 9999.9 mm/min.
    """
    if not 0.1 <= speed_mm_min <= 9999.9:
        raise ValueError(f"stand speed: expected 0.1 .. 9999.9 mm/min, found {speed_mm_min:g}")
    return b"e%06.1f" % speed_mm_min


def limit_command(letter: bytes, travel_mm: float) -> bytes:
    """Return ``gXXX.XX`` (lower) or ``hXXX.XX`` (upper), with a minus sign where negative.

    Raises:
        ValueError: beyond what the command can express.
    """
    if abs(travel_mm) > LONGEST_TRAVEL_MM:
        raise ValueError(f"stand limit: expected within {LONGEST_TRAVEL_MM} mm, found {travel_mm:g}")
    sign = b"-" if round(travel_mm, 2) < 0.0 else b""
    return letter + sign + b"%06.2f" % abs(travel_mm)


def parse_travel(line: bytes) -> float:
    """Return the travel [m] of a reply such as ``2.00 mm``.

    Raises:
        CorruptReplyError: anything else; a stand in inches too, for limits would then mean something else.
    """
    match = _LENGTH.fullmatch(line)
    if match is None:
        raise CorruptReplyError(f"stand: expected a travel like '2.00 mm', found {line!r}")
    if match[2] == b"in":
        raise CorruptReplyError(
            f"stand: expected millimetres, found inches ({line!r}); was the unit switched at the panel?"
        )
    return float(match[1]) * 1e-3


def parse_number(line: bytes) -> float:
    """Return the leading number of a reply (speed; the form of its unit is not documented)."""
    match = _NUMBER.fullmatch(line)
    if match is None:
        raise CorruptReplyError(f"stand: expected a number, found {line!r}")
    return float(match[1])


def parse_reading(line: bytes) -> tuple[float, str]:
    """Return number and unit of a reading such as ``-18.78 lbF``; the unit is empty in NUM format.

    Raises:
        RefusedError: an error code (``*10``, ...). SaturatedError: the overload text. CorruptReplyError: anything else.
    """
    text = line.decode("ascii", "replace").strip()
    if text in _ERRORS:
        raise DeviceRefusedError(f"gauge: expected a reading, found {text} ({_ERRORS[text]})", int(text[1:]))
    if text.upper().startswith(("OVER", "OL")):
        raise SaturatedError(f"gauge: the force is beyond its capacity ({text}); take weight off, use a bigger gauge")
    match = _READING.fullmatch(text)
    if match is None:
        raise CorruptReplyError(f"gauge: expected a reading like '-18.78 N', found {line!r}")
    return float(match[1]), match[2] or ""


@dataclass(frozen=True)
class GaugeSettings:
    """What ``LIST`` tells.

    Attributes:
        version: firmware. unit: as in readings. mode: CUR is the present force. auto_output: AOUT number, 0 is off.
        filter_current: samples averaged. battery: 0 full .. 3 low.
    """

    version: str
    unit: str
    mode: str
    auto_output: int
    filter_current: int
    battery: int


def parse_list(line: bytes) -> GaugeSettings:
    """Parse ``V1.00;LBF;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0``.

    Raises:
        CorruptReplyError: anything else. RefusedError: an error code.
    """
    text = line.decode("ascii", "replace").strip()
    if text in _ERRORS:
        raise DeviceRefusedError(f"gauge: expected its settings, found {text} ({_ERRORS[text]})", int(text[1:]))
    words = text.split(";")
    numbered = {match[1]: int(match[2]) for word in words if (match := re.fullmatch(r"(FLTC|AOUT|B)(\d+)", word))}
    if len(words) < 8 or not {"FLTC", "AOUT"} <= numbered.keys():
        raise CorruptReplyError(f"gauge: expected its settings (V1.00;N;CUR;...), found {line!r}")
    unit = _UNIT_NAMES.get(words[1], words[1])
    return GaugeSettings(words[0], unit, words[2], numbered["AOUT"], numbered["FLTC"], numbered.get("B", 0))
