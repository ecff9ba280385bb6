# SPDX-License-Identifier: Apache-2.0
"""Camera controls against what the kernel's uvcvideo driver answered for real cameras.

A Logitech HD Webcam C525 on Linux 5.15: `v4l2-ctl --all` and `strace v4l2-compliance` by James Hilliard, linux-media,
11 November 2021, "Re: [PATCH 0/4] Follow-up patches for uvc v4l2-compliance", message
CADvTj4r_SzChXj04Ddn6PPUDN7QnKczm6MJXeES-uUUQx3ds+Q@mail.gmail.com. A webcam without focus: `v4l2-ctl -l` in
github.com/kraudust/personal_software_notes, usb_cameras/linux_interaction.md, commit 106be5e8.
"""

from __future__ import annotations

import errno
import struct
from dataclasses import dataclass

import pytest

from softgrip_vision import v4l2_controls as v4l2
from softgrip_vision.v4l2_controls import ControlSettings, apply_controls

#: v4l2_ctrl_type and V4L2_CTRL_FLAG_INACTIVE (linux/videodev2.h)
INTEGER, BOOLEAN, MENU = 1, 2, 3
INACTIVE = 0x0010


@dataclass(frozen=True)
class Control:
    """A control as VIDIOC_QUERYCTRL tells it.

    Attributes:
        kind: v4l2_ctrl_type.
        name: as the kernel names it.
        low, high, step, default, value: what the listing has; of booleans and menus, which it lists without a step, 1.
        menu: the values that a menu has.
        gate: the control that takes it over, and the value with which it does not.
    """

    kind: int
    name: bytes
    low: int
    high: int
    step: int
    default: int
    value: int
    menu: tuple[int, ...] = ()
    gate: tuple[int, int] | None = None


C525 = {
    v4l2.AUTO_WHITE_BALANCE: Control(BOOLEAN, b"White Balance, Automatic", 0, 1, 1, 1, 1),
    v4l2.GAIN: Control(INTEGER, b"Gain", 0, 255, 1, 64, 64),
    v4l2.POWER_LINE_FREQUENCY: Control(MENU, b"Power Line Frequency", 0, 2, 1, 2, 2, menu=(0, 1, 2)),
    v4l2.WHITE_BALANCE_TEMPERATURE: Control(
        INTEGER, b"White Balance Temperature", 2800, 6500, 1, 5500, 5500, gate=(v4l2.AUTO_WHITE_BALANCE, 0)
    ),
    v4l2.AUTO_EXPOSURE: Control(MENU, b"Auto Exposure", 0, 3, 1, 3, 3, menu=(1, 3)),
    v4l2.EXPOSURE_TIME: Control(
        INTEGER, b"Exposure Time, Absolute", 3, 2047, 1, 166, 166, gate=(v4l2.AUTO_EXPOSURE, 1)
    ),
    v4l2.FOCUS: Control(INTEGER, b"Focus, Absolute", 0, 255, 5, 60, 60, gate=(v4l2.AUTO_FOCUS, 0)),
    v4l2.AUTO_FOCUS: Control(BOOLEAN, b"Focus, Automatic Continuous", 0, 1, 1, 1, 1),
}
WITHOUT_FOCUS = {
    v4l2.AUTO_WHITE_BALANCE: Control(BOOLEAN, b"White Balance, Automatic", 0, 1, 1, 1, 1),
    v4l2.GAIN: Control(INTEGER, b"Gain", 1, 8, 1, 1, 8),
    v4l2.POWER_LINE_FREQUENCY: Control(MENU, b"Power Line Frequency", 0, 2, 1, 2, 2, menu=(0, 1, 2)),
    v4l2.WHITE_BALANCE_TEMPERATURE: Control(
        INTEGER, b"White Balance Temperature", 2800, 6500, 10, 4600, 4600, gate=(v4l2.AUTO_WHITE_BALANCE, 0)
    ),
    v4l2.AUTO_EXPOSURE: Control(MENU, b"Auto Exposure", 0, 3, 1, 3, 1, menu=(1, 3)),
    v4l2.EXPOSURE_TIME: Control(
        INTEGER, b"Exposure Time, Absolute", 10, 700, 1, 156, 500, gate=(v4l2.AUTO_EXPOSURE, 1)
    ),
}

#: VIDIOC_S_CTRL of the C525, in the order of the recording: control, value, and what came back or the error
SET = (
    (v4l2.AUTO_WHITE_BALANCE, 1, 1), (v4l2.AUTO_WHITE_BALANCE, -1, 0), (v4l2.AUTO_WHITE_BALANCE, 2, 1),
    (v4l2.AUTO_WHITE_BALANCE, 0, 0), (v4l2.AUTO_WHITE_BALANCE, 1, 1), (v4l2.AUTO_WHITE_BALANCE, 1, 1),
    (v4l2.GAIN, 64, 64), (v4l2.GAIN, -1, 255), (v4l2.GAIN, 256, 255), (v4l2.GAIN, 0, 0), (v4l2.GAIN, 255, 255),
    (v4l2.GAIN, 64, 64),
    (v4l2.POWER_LINE_FREQUENCY, 2, 2), (v4l2.POWER_LINE_FREQUENCY, -1, "ERANGE"),
    (v4l2.POWER_LINE_FREQUENCY, 3, "ERANGE"), (v4l2.POWER_LINE_FREQUENCY, 0, 0), (v4l2.POWER_LINE_FREQUENCY, 1, 1),
    (v4l2.POWER_LINE_FREQUENCY, 2, 2),
    (v4l2.WHITE_BALANCE_TEMPERATURE, 5500, "EACCES"), (v4l2.WHITE_BALANCE_TEMPERATURE, 2799, "EACCES"),
    (v4l2.WHITE_BALANCE_TEMPERATURE, 6501, "EACCES"), (v4l2.WHITE_BALANCE_TEMPERATURE, 2800, "EACCES"),
    (v4l2.WHITE_BALANCE_TEMPERATURE, 6500, "EACCES"), (v4l2.WHITE_BALANCE_TEMPERATURE, 5500, "EACCES"),
    (v4l2.AUTO_EXPOSURE, 3, 3), (v4l2.AUTO_EXPOSURE, -1, "ERANGE"), (v4l2.AUTO_EXPOSURE, 4, "ERANGE"),
    (v4l2.AUTO_EXPOSURE, 0, "EINVAL"), (v4l2.AUTO_EXPOSURE, 1, 1), (v4l2.AUTO_EXPOSURE, 2, "EINVAL"),
    (v4l2.AUTO_EXPOSURE, 3, 3),
    (v4l2.EXPOSURE_TIME, 166, "EACCES"), (v4l2.EXPOSURE_TIME, 2, "EACCES"), (v4l2.EXPOSURE_TIME, 2048, "EACCES"),
    (v4l2.EXPOSURE_TIME, 3, "EACCES"), (v4l2.EXPOSURE_TIME, 2047, "EACCES"), (v4l2.EXPOSURE_TIME, 166, "EACCES"),
    (v4l2.FOCUS, 60, "EACCES"), (v4l2.FOCUS, -1, "EACCES"), (v4l2.FOCUS, 256, "EACCES"), (v4l2.FOCUS, 1, "EACCES"),
    (v4l2.FOCUS, 0, "EACCES"), (v4l2.FOCUS, 255, "EACCES"), (v4l2.FOCUS, 60, "EACCES"),
    (v4l2.AUTO_FOCUS, 1, 1), (v4l2.AUTO_FOCUS, -1, 0), (v4l2.AUTO_FOCUS, 2, 1), (v4l2.AUTO_FOCUS, 0, 0),
    (v4l2.AUTO_FOCUS, 1, 1), (v4l2.AUTO_FOCUS, 1, 1),
)  # fmt: skip


class UvcCamera:
    """Answers as uvcvideo did: refuses what is automatic with EACCES, bounds numbers, rounds them to a step.

    The gain of the C525 was bounded as an unsigned number: -1 became 255.
    """

    def __init__(self, controls: dict[int, Control]) -> None:
        self.controls = controls
        self.values = {number: control.value for number, control in controls.items()}

    def ioctl(self, request: int, data: bytes) -> bytes:
        (number,) = struct.unpack_from("=I", data)
        if number not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        control = self.controls[number]
        if request == v4l2.QUERY_CONTROL:
            flags = INACTIVE if self._is_taken_over(control) else 0
            return struct.pack(
                "=II32siiiiI8x",
                number, control.kind, control.name, control.low, control.high, control.step, control.default, flags,
            )  # fmt: skip
        if request == v4l2.SET_CONTROL:
            self._set(number, control, struct.unpack("=Ii", data)[1])
        return struct.pack("=Ii", number, self.values[number])

    def _is_taken_over(self, control: Control) -> bool:
        return control.gate is not None and self.values[control.gate[0]] != control.gate[1]

    def _set(self, number: int, control: Control, value: int) -> None:
        if self._is_taken_over(control):
            raise OSError(errno.EACCES, "Permission denied")
        if control.kind == MENU:
            if not control.low <= value <= control.high:
                raise OSError(errno.ERANGE, "Numerical result out of range")
            if value not in control.menu:
                raise OSError(errno.EINVAL, "Invalid argument")
        elif control.kind == INTEGER and control.low >= 0 and value < 0:
            value = control.high
        value = min(max(value, control.low), control.high)
        self.values[number] = control.low + (value - control.low + control.step // 2) // control.step * control.step


def test_the_stand_in_answers_as_was_recorded() -> None:
    camera, answers = UvcCamera(C525), []
    for number, value, _ in SET:
        try:
            answered = camera.ioctl(v4l2.SET_CONTROL, struct.pack("=Ii", number, value))
            answers.append((number, value, struct.unpack("=Ii", answered)[1]))
        except OSError as error:
            answers.append((number, value, errno.errorcode[error.errno or 0]))
    assert answers == list(SET)
    assert camera.values == {number: control.value for number, control in C525.items()}


@pytest.mark.parametrize(
    ("controls", "settings", "expected", "automatic"),
    [
        (
            C525,
            ControlSettings(exposure_s=0.008, gain=12, focus=35, white_balance_k=4600, power_line_hz=50),
            {"exposure_100us": "80", "gain": "12", "focus": "35", "white_balance_k": "4600", "power_line": "1"},
            (),
        ),
        (C525, ControlSettings(), {}, ("exposure", "white balance", "focus")),
        (
            WITHOUT_FOCUS,
            ControlSettings(exposure_s=0.008, gain=4, power_line_hz=50),
            {"exposure_100us": "80", "gain": "4", "power_line": "1"},
            ("white balance",),
        ),
    ],
)
def test_a_real_cameras_controls_are_set(
    controls: dict[int, Control], settings: ControlSettings, expected: dict[str, str], automatic: tuple[str, ...]
) -> None:
    camera = UvcCamera(controls)
    found = apply_controls(settings, camera.ioctl)
    assert (found.values, found.problems, found.automatic) == (expected, (), automatic)


def test_what_it_can_not_is_said_before_it_is_bounded_silently() -> None:
    """The C525 took 255 for a gain of 300 and of -2; both would pass for the gain that was asked for."""
    camera = UvcCamera(C525)
    found = apply_controls(ControlSettings(gain=300, exposure_s=0.5), camera.ioctl)
    assert found.problems == (
        "exposure_100us: expected 3 to 2047 of this camera, found 5000",
        "gain: expected 0 to 255 of this camera, found 300",
    )
    assert camera.values == UvcCamera(C525).values
    (problem,) = apply_controls(ControlSettings(focus=35), UvcCamera(WITHOUT_FOCUS).ioctl).problems
    assert problem.startswith("focus: expected a camera that can set it")


def test_a_focus_between_two_steps_is_said_as_the_camera_has_it() -> None:
    camera = UvcCamera(C525)
    found = apply_controls(ControlSettings(focus=37), camera.ioctl)
    assert (found.values, found.problems) == ({"focus": "35"}, ())
    assert camera.values[v4l2.FOCUS] == 35
