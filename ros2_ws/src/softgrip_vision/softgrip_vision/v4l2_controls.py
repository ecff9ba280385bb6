# SPDX-License-Identifier: Apache-2.0
"""Exposure, gain, focus, white balance and power-line frequency of a V4L2 camera, as ioctls without any device.

Source: linux/videodev2.h and linux/v4l2-controls.h (structures, numbers, units: exposure in 100 us, white balance in
K). A camera that chooses its exposure by itself moves the markers' edges with the light, and one set to the wrong
power-line frequency flickers.
"""

from __future__ import annotations

import errno
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

#: (request, structure) to the structure as the driver leaves it; raises OSError.
Ioctl = Callable[[int, bytes], bytes]

_CONTROL = struct.Struct("=Ii")  # v4l2_control: id, value
_QUERY = struct.Struct("=II32siiiiI8x")  # v4l2_queryctrl: id, type, name, minimum, maximum, step, default, flags
_READ_WRITE = 3


def _request(number: int, size: int) -> int:
    """Return _IOWR('V', number, size bytes) (asm-generic/ioctl.h)."""
    return _READ_WRITE << 30 | size << 16 | ord("V") << 8 | number


GET_CONTROL = _request(27, _CONTROL.size)
SET_CONTROL = _request(28, _CONTROL.size)
QUERY_CONTROL = _request(36, _QUERY.size)

_USER, _CAMERA = 0x00980900, 0x009A0900
AUTO_WHITE_BALANCE, GAIN = _USER + 12, _USER + 19
POWER_LINE_FREQUENCY, WHITE_BALANCE_TEMPERATURE = _USER + 24, _USER + 26
AUTO_EXPOSURE, EXPOSURE_TIME = _CAMERA + 1, _CAMERA + 2
FOCUS, AUTO_FOCUS = _CAMERA + 10, _CAMERA + 12
#: v4l2_exposure_auto_type: the time is set by hand in both
MANUAL_EXPOSURE, SHUTTER_PRIORITY = 1, 2
_DISABLED = 0x0001
#: [s] of one unit of EXPOSURE_TIME
EXPOSURE_UNIT_S = 1e-4
#: [Hz] to v4l2_power_line_frequency
POWER_LINE = {0: 0, 50: 1, 60: 2}
#: leave it to the camera
LEAVE = -1


@dataclass(frozen=True)
class ControlSettings:
    """What to set of a camera.

    Attributes:
        exposure_s: [s]; 0 leaves it to the camera. white_balance_k: [K] likewise.
        gain: in the camera's own unit; -1 leaves it. focus: likewise.
        power_line_hz: 0 (no lamps), 50 or 60; -1 leaves it.
    """

    exposure_s: float = 0.0
    gain: int = LEAVE
    focus: int = LEAVE
    white_balance_k: int = 0
    power_line_hz: int = LEAVE


@dataclass(frozen=True)
class ControlReport:
    """What came of it.

    Attributes:
        values: name to value of everything that was set, as the camera says it is now.
        problems: what could not be set, and why.
        automatic: what the camera chooses by itself.
    """

    values: dict[str, str]
    problems: tuple[str, ...]
    automatic: tuple[str, ...]


@dataclass(frozen=True)
class _Order:
    """One value to set: its name, its control, and what must be off before."""

    name: str
    control: int
    value: int
    automatic: tuple[int, int] | None = None


class _NotSetError(Exception):
    """A value that the camera does not have now, and why."""


def apply_controls(settings: ControlSettings, ioctl: Ioctl) -> ControlReport:
    """Set what is asked for, read it back, and look at what the camera does by itself. Never raises OSError."""
    values: dict[str, str] = {}
    problems = []
    for order in _orders(settings):
        try:
            values[order.name] = str(_set(order, ioctl))
        except _NotSetError as error:
            problems.append(str(error))
        except OSError as error:
            problems.append(f"{order.name}: expected the camera to answer, found {error}")
    return ControlReport(values, tuple(problems), _automatic(ioctl))


def _orders(settings: ControlSettings) -> list[_Order]:
    orders = []
    if settings.exposure_s:
        units = max(1, math.floor(settings.exposure_s / EXPOSURE_UNIT_S + 0.5))
        orders.append(_Order("exposure_100us", EXPOSURE_TIME, units, (AUTO_EXPOSURE, MANUAL_EXPOSURE)))
    if settings.gain != LEAVE:
        orders.append(_Order("gain", GAIN, settings.gain))
    if settings.focus != LEAVE:
        orders.append(_Order("focus", FOCUS, settings.focus, (AUTO_FOCUS, 0)))
    if settings.white_balance_k:
        orders.append(
            _Order("white_balance_k", WHITE_BALANCE_TEMPERATURE, settings.white_balance_k, (AUTO_WHITE_BALANCE, 0))
        )
    if settings.power_line_hz != LEAVE:
        orders.append(_Order("power_line", POWER_LINE_FREQUENCY, POWER_LINE[settings.power_line_hz]))
    return orders


def _set(order: _Order, ioctl: Ioctl) -> int:
    """Set one value; return what the camera made of it, up to its step.

    Raises:
        _NotSetError: it has none, or did not take it.
    """
    found = _range(order.control, ioctl)
    if found is None:
        raise _NotSetError(
            f"{order.name}: expected a camera that can set it, found none; leave its parameter at its default"
        )
    low, high, step = found
    # Beyond its range a camera takes the nearest value, or the largest for one below nothing, and says nothing.
    if not low <= order.value <= high:
        raise _NotSetError(f"{order.name}: expected {low} to {high} of this camera, found {order.value}")
    try:
        if order.automatic is not None and _range(order.automatic[0], ioctl) is not None:
            ioctl(SET_CONTROL, _CONTROL.pack(*order.automatic))
        ioctl(SET_CONTROL, _CONTROL.pack(order.control, order.value))
        taken = _get(order.control, ioctl)
    except OSError as error:
        raise _NotSetError(f"{order.name}: expected the camera to take {order.value}, found {error}") from error
    if abs(taken - order.value) >= max(step, 1):
        raise _NotSetError(f"{order.name}: expected {order.value}, found {taken}: the camera did not take it")
    return taken


def _automatic(ioctl: Ioctl) -> tuple[str, ...]:
    """Return what the camera chooses by itself."""
    found = []
    for name, control, by_hand in (
        ("exposure", AUTO_EXPOSURE, (MANUAL_EXPOSURE, SHUTTER_PRIORITY)),
        ("white balance", AUTO_WHITE_BALANCE, (0,)),
        ("focus", AUTO_FOCUS, (0,)),
    ):
        try:
            if _range(control, ioctl) is not None and _get(control, ioctl) not in by_hand:
                found.append(name)
        except OSError:
            continue  # it can be asked for, but not read: nothing is known of it
    return tuple(found)


def _get(control: int, ioctl: Ioctl) -> int:
    return int(_CONTROL.unpack(ioctl(GET_CONTROL, _CONTROL.pack(control, 0)))[1])


def _range(control: int, ioctl: Ioctl) -> tuple[int, int, int] | None:
    """Return lowest and highest value and step of a control; None where the camera has none."""
    asked = _QUERY.pack(control, 0, b"", 0, 0, 0, 0, 0)
    try:
        _, _, _, low, high, step, _, flags = _QUERY.unpack(ioctl(QUERY_CONTROL, asked))
    except OSError as error:
        if error.errno in {errno.EINVAL, errno.ENOTTY, errno.EACCES}:
            return None
        raise
    return None if flags & _DISABLED else (low, high, step)
