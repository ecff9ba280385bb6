# SPDX-License-Identifier: Apache-2.0
"""A Mark-10 Series 5/7 force gauge (GCL2), as a gauge."""

from __future__ import annotations

import contextlib

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, DriverError, UnitChangedError
from softgrip_driver.rig import mark10
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.line_port import LinePort

_UNIT = "N"
_LOW_BATTERY = 3
#: Force lines to look through for an answer while automatic output is on.
_MAX_LINES = 20
#: [N] what may be left after zeroing: noise.
_ZERO_TOLERANCE = 0.1


class Mark10Gauge:
    """The gauge, in newtons and present force. It counts compression positive, so tension is its negative.

    Args:
        port: its serial port (115200 8N1).
    """

    def __init__(self, port: LinePort) -> None:
        self._port = port
        self._auto_output_before = 0

    def open(self) -> DeviceIdentity:
        """Connect, silence automatic output, set newtons and present force, and check that it took."""
        self._port.open()
        found = self._settings()
        self.restore()
        taken = self._settings()
        if (taken.unit, taken.mode, taken.auto_output) != (_UNIT, "CUR", 0):
            raise DeviceRefusedError(
                f"gauge: expected the settings {_UNIT}, CUR, AOUT00, found {taken.unit}, {taken.mode}, "
                f"AOUT{taken.auto_output:02d}; leave its menu and try again",
                0,
            )
        self._auto_output_before = found.auto_output
        warnings = ("battery low: charge the gauge",) if taken.battery >= _LOW_BATTERY else ()
        return DeviceIdentity(f"Mark-10 gauge {taken.version}", warnings=warnings)

    def tare(self) -> None:
        """Make the present force zero, and check that it is.

        Raises:
            RefusedError: it is not.
        """
        self._send("Z")
        left = self.tension()
        if abs(left) > _ZERO_TOLERANCE:
            raise DeviceRefusedError(f"gauge: expected 0 N after zeroing, found {left:.2f} N; keep the cable still", 0)

    def tension(self) -> float:
        """Tension now [N].

        Raises:
            CorruptReplyError: force lines nobody asked for were on the wire; the first of them may be cut, and a cut
                number is a valid wrong number.
        """
        unasked = self._port.drain()
        if unasked:
            self.restore()
            raise CorruptReplyError(
                f"gauge: expected silence before a request, found {unasked} bytes: automatic output was switched on at "
                "the panel; it is switched off again, measure the point again"
            )
        self._send("?")
        number, unit = mark10.parse_reading(self._port.read_line())
        if unit != _UNIT:
            self.restore()
            raise UnitChangedError(
                f"gauge: expected newtons, found '{unit or 'no unit'}': the unit or format was switched at the panel; "
                "it is set back, measure the point again"
            )
        return -number

    def restore(self) -> None:
        """Set newtons and present force again, after somebody touched the panel."""
        for word in ("AOUT0", _UNIT, "CUR", "FULL"):
            self._send(word)
        self._port.drain(quiet=0.05)

    def close(self) -> None:
        """Leave automatic output as it was found, and disconnect."""
        if self._port.is_open and self._auto_output_before:
            with contextlib.suppress(DriverError):
                self._send(f"AOUT{self._auto_output_before}")
        self._port.close()

    def _settings(self) -> mark10.GaugeSettings:
        """Ask for the settings; automatic output may talk in between."""
        self._port.drain()
        self._send("LIST")
        for _ in range(_MAX_LINES):
            line = self._port.read_line()
            if b";" in line or line.startswith(b"*"):
                break
        return mark10.parse_list(line)

    def _send(self, word: str) -> None:
        self._port.write(word.encode("ascii") + b"\r")
