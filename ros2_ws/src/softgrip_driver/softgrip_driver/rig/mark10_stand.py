# SPDX-License-Identifier: Apache-2.0
"""A Mark-10 ESM test stand under PC control, as a stage."""

from __future__ import annotations

import contextlib

from softgrip_driver.errors import DeviceRefusedError, DriverError, NoReplyError
from softgrip_driver.rig import mark10
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.rig.line_port import LinePort

#: [m] read-back tolerance of a limit: the stand keeps hundredths of a millimetre.
_LIMIT_TOLERANCE = 0.02e-3
_M_PER_S_TO_MM_PER_MIN = 60e3
_NO_PC_CONTROL = (
    "PC control is off (Auto Return or Cycling pressed at the panel, or CONTROL not set to PC): switch it on again"
)


class Mark10Stand:
    """The stand. Up pulls; it stops at its own limit, so that it does also when this process dies.

    Args:
        port: its serial port (115200 8N1, CONTROL: PC).
    """

    def __init__(self, port: LinePort) -> None:
        self._port = port

    def open(self) -> DeviceIdentity:
        """Connect, stop, set millimetres and limit mode."""
        self._port.open()
        self.stop()
        self._port.write(mark10.MILLIMETRES + mark10.LIMIT_MODE)
        status = self._ask(mark10.REQUEST_STATUS).decode("ascii", "replace").strip()
        self.travel()
        return DeviceIdentity(f"Mark-10 stand (status {status})")

    def zero(self) -> None:
        """Make this the zero of travel, and check that it is.

        Raises:
            RefusedError: travel is not zero afterwards.
        """
        self._port.write(mark10.ZERO_TRAVEL)
        travel = self.travel()
        if abs(travel) > _LIMIT_TOLERANCE:
            raise self._refused("zero its travel", f"a travel of {travel * 1e3:.2f} mm")

    def start(self, target: float, speed: float) -> None:
        """Begin to move to a travel [m] at a speed [m/s].

        Raises:
            RefusedError: speed or limit were not taken.
        """
        up = target > self.travel()
        letter, request = (b"h", mark10.REQUEST_UPPER) if up else (b"g", mark10.REQUEST_LOWER)
        speed_mm_min = round(speed * _M_PER_S_TO_MM_PER_MIN, 1)
        self._port.write(mark10.speed_command(speed_mm_min))
        self._port.write(mark10.limit_command(letter, target * 1e3))
        # The stand reports no error for a command it did not take: read back what motion depends on.
        limit = mark10.parse_travel(self._ask(request))
        if abs(limit - target) > _LIMIT_TOLERANCE:
            raise self._refused(f"take a limit of {target * 1e3:.2f} mm", f"{limit * 1e3:.2f} mm")
        taken = mark10.parse_number(self._ask(mark10.REQUEST_SPEED))
        if abs(taken - speed_mm_min) > 0.05:
            raise self._refused_speed(speed_mm_min, taken)
        self._port.write(mark10.LIMIT_MODE + (mark10.UP if up else mark10.DOWN))

    def travel(self) -> float:
        """Where the stage is [m]."""
        return mark10.parse_travel(self._ask(mark10.REQUEST_TRAVEL))

    def stop(self) -> None:
        """Stand still now."""
        self._port.write(mark10.STOP)

    def unlock(self) -> None:
        """It knows no alarm; a stand that left PC control is switched back at its panel."""

    def close(self) -> None:
        """Stop and disconnect."""
        if self._port.is_open:
            with contextlib.suppress(DriverError):
                self.stop()
        self._port.close()

    def _ask(self, request: bytes) -> bytes:
        self._port.drain()
        self._port.write(request)
        try:
            return self._port.read_line()
        except NoReplyError as error:
            raise NoReplyError(f"stand: asked '{request.decode()}': {error}") from error

    def _refused_speed(self, asked_mm_min: float, taken_mm_min: float) -> DeviceRefusedError:
        """Return why a speed was not taken: beyond the stand's own, or it is not under control.

        It is asked for its fastest, which it takes where it is under control; a motion sets its own speed before.
        """
        what, found = f"take a speed of {asked_mm_min:.1f} mm/min", f"{taken_mm_min:.1f} mm/min"
        self._port.write(mark10.MAX_SPEED)
        fastest = mark10.parse_number(self._ask(mark10.REQUEST_SPEED))
        if fastest >= asked_mm_min:
            return self._refused(what, found)
        unheard = f"; or {_NO_PC_CONTROL}" if fastest == taken_mm_min else ""
        return DeviceRefusedError(
            f"stand: expected it to {what}, found {found}: its fastest is {fastest:.1f} mm/min; ask for at most "
            f"{fastest / _M_PER_S_TO_MM_PER_MIN:.4f} m/s (friction_rig: speed, return_speed; a tendon on it: "
            f"speed_m_s, release_speed_m_s){unheard}",
            0,
        )

    @staticmethod
    def _refused(what: str, found: str) -> DeviceRefusedError:
        return DeviceRefusedError(f"stand: expected it to {what}, found {found}; {_NO_PC_CONTROL}", 0)
