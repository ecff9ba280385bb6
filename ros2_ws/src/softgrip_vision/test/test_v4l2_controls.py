# SPDX-License-Identifier: Apache-2.0
"""Camera controls against the kernel's own structures: bytes as gcc lays them out from linux/videodev2.h."""

from __future__ import annotations

import errno
import struct
from pathlib import Path

import pytest

from softgrip_vision import v4l2_controls as v4l2
from softgrip_vision.sources.opencv import _apply_controls
from softgrip_vision.v4l2_controls import ControlSettings, apply_controls

#: printed by a C program: sizeof, offsetof and the structures themselves, x86-64, Linux 6
GCC = {
    "VIDIOC_G_CTRL": 0xC008561B,
    "VIDIOC_S_CTRL": 0xC008561C,
    "VIDIOC_QUERYCTRL": 0xC0445624,
    "EXPOSURE_AUTO": 0x9A0901,
    "EXPOSURE_ABSOLUTE": 0x9A0902,
    "FOCUS_AUTO": 0x9A090C,
    "FOCUS_ABSOLUTE": 0x9A090A,
    "AUTO_WHITE_BALANCE": 0x98090C,
    "WHITE_BALANCE_TEMPERATURE": 0x98091A,
    "GAIN": 0x980913,
    "POWER_LINE_FREQUENCY": 0x980918,
}
#: {.id = EXPOSURE_ABSOLUTE, .type = 1, .name = "Exposure Time, Absolute", 3, 2047, 1, 250, .flags = INACTIVE}
QUERY_EXPOSURE = bytes.fromhex(
    "02099a00010000004578706f737572652054696d652c204162736f6c75746500000000000000000003000000ff07000001000000fa000000"
    "100000000000000000000000"
)
#: {V4L2_CID_GAIN, -5}
CONTROL_GAIN = bytes.fromhex("13099800fbffffff")


class Camera:
    """Answers as cameras may: controls with ranges; what is automatic refuses a value (EBUSY; uvcvideo says EACCES).

    What uvcvideo answered for real cameras is in test_v4l2_recorded.py.
    """

    def __init__(self, **without: bool) -> None:
        self.values = {
            v4l2.AUTO_EXPOSURE: 3, v4l2.EXPOSURE_TIME: 250, v4l2.AUTO_WHITE_BALANCE: 1,
            v4l2.WHITE_BALANCE_TEMPERATURE: 4000, v4l2.AUTO_FOCUS: 1, v4l2.FOCUS: 0, v4l2.GAIN: 0,
            v4l2.POWER_LINE_FREQUENCY: 2,
        }  # fmt: skip
        self.ranges = {
            v4l2.AUTO_EXPOSURE: (0, 3, 1), v4l2.EXPOSURE_TIME: (3, 2047, 1), v4l2.AUTO_WHITE_BALANCE: (0, 1, 1),
            v4l2.WHITE_BALANCE_TEMPERATURE: (2000, 6500, 10), v4l2.AUTO_FOCUS: (0, 1, 1), v4l2.FOCUS: (0, 250, 5),
            v4l2.GAIN: (0, 255, 1), v4l2.POWER_LINE_FREQUENCY: (0, 2, 1),
        }  # fmt: skip
        self.automatic = {
            v4l2.EXPOSURE_TIME: (v4l2.AUTO_EXPOSURE, (1, 2)), v4l2.FOCUS: (v4l2.AUTO_FOCUS, (0,)),
            v4l2.WHITE_BALANCE_TEMPERATURE: (v4l2.AUTO_WHITE_BALANCE, (0,)),
        }  # fmt: skip
        if without.get("focus"):
            del self.ranges[v4l2.FOCUS], self.ranges[v4l2.AUTO_FOCUS]

    def ioctl(self, request: int, data: bytes) -> bytes:
        (control,) = struct.unpack_from("=I", data)
        if control not in self.ranges:
            raise OSError(errno.EINVAL, "Invalid argument")
        if request == GCC["VIDIOC_QUERYCTRL"]:
            assert len(data) == 68
            return data[:40] + struct.pack("=iiiiI8x", *self.ranges[control], 0, 0)
        assert len(data) == 8
        if request == GCC["VIDIOC_S_CTRL"]:
            gate, by_hand = self.automatic.get(control, (control, (self.values[control],)))
            if self.values[gate] not in by_hand:
                raise OSError(errno.EBUSY, "Device or resource busy")
            step = self.ranges[control][2]
            self.values[control] = struct.unpack("=Ii", data)[1] // step * step
        return struct.pack("=Ii", control, self.values[control])


def test_numbers_and_structures_are_the_kernels() -> None:
    assert (GCC["VIDIOC_G_CTRL"], GCC["VIDIOC_S_CTRL"]) == (v4l2.GET_CONTROL, v4l2.SET_CONTROL)
    assert GCC["VIDIOC_QUERYCTRL"] == v4l2.QUERY_CONTROL
    assert (GCC["EXPOSURE_AUTO"], GCC["EXPOSURE_ABSOLUTE"]) == (v4l2.AUTO_EXPOSURE, v4l2.EXPOSURE_TIME)
    assert (GCC["FOCUS_AUTO"], GCC["FOCUS_ABSOLUTE"]) == (v4l2.AUTO_FOCUS, v4l2.FOCUS)
    assert GCC["AUTO_WHITE_BALANCE"] == v4l2.AUTO_WHITE_BALANCE
    assert GCC["WHITE_BALANCE_TEMPERATURE"] == v4l2.WHITE_BALANCE_TEMPERATURE
    assert (GCC["GAIN"], GCC["POWER_LINE_FREQUENCY"]) == (v4l2.GAIN, v4l2.POWER_LINE_FREQUENCY)
    assert v4l2._range(v4l2.EXPOSURE_TIME, lambda _, __: QUERY_EXPOSURE) == (3, 2047, 1)
    assert v4l2._get(v4l2.GAIN, lambda _, __: CONTROL_GAIN) == -5


def test_everything_is_set_by_hand_in_the_cameras_units() -> None:
    camera = Camera()
    settings = ControlSettings(exposure_s=0.008, gain=12, focus=35, white_balance_k=4600, power_line_hz=50)
    found = apply_controls(settings, camera.ioctl)
    assert (found.problems, found.automatic) == ((), ())
    assert camera.values == {
        v4l2.AUTO_EXPOSURE: 1, v4l2.EXPOSURE_TIME: 80, v4l2.AUTO_WHITE_BALANCE: 0,
        v4l2.WHITE_BALANCE_TEMPERATURE: 4600, v4l2.AUTO_FOCUS: 0, v4l2.FOCUS: 35, v4l2.GAIN: 12,
        v4l2.POWER_LINE_FREQUENCY: 1,
    }  # fmt: skip


def test_a_camera_left_alone_says_what_it_chooses_by_itself() -> None:
    camera = Camera()
    before = dict(camera.values)
    assert apply_controls(ControlSettings(), camera.ioctl).automatic == ("exposure", "white balance", "focus")
    assert camera.values == before
    camera.values[v4l2.AUTO_EXPOSURE] = v4l2.SHUTTER_PRIORITY
    assert "exposure" not in apply_controls(ControlSettings(), camera.ioctl).automatic


def test_what_a_camera_has_not_or_can_not_is_said_and_the_rest_is_set() -> None:
    camera = Camera(focus=True)
    found = apply_controls(ControlSettings(exposure_s=0.5, gain=3, focus=35), camera.ioctl)
    assert "exposure_100us: expected 3 to 2047 of this camera, found 5000" in found.problems
    assert any(text.startswith("focus: expected a camera that can set it") for text in found.problems)
    assert found.values == {"gain": "3"}


def test_a_step_is_no_problem_and_a_value_that_was_not_taken_is() -> None:
    camera = Camera()
    assert apply_controls(ControlSettings(focus=37), camera.ioctl).problems == ()
    assert camera.values[v4l2.FOCUS] == 35
    camera.ranges[v4l2.GAIN] = (0, 255, 1)
    stubborn = camera.ioctl

    def ioctl(request: int, data: bytes) -> bytes:
        is_gain = struct.unpack_from("=I", data)[0] == v4l2.GAIN
        return data if request == v4l2.SET_CONTROL and is_gain else stubborn(request, data)

    (problem,) = apply_controls(ControlSettings(gain=9), ioctl).problems
    assert problem == "gain: expected 9, found 0: the camera did not take it"


@pytest.mark.parametrize("error", [errno.EIO, errno.ENODEV])
def test_a_camera_that_was_unplugged_meanwhile_is_a_problem_and_no_crash(error: int) -> None:
    def ioctl(request: int, data: bytes) -> bytes:
        raise OSError(error, "gone")

    assert apply_controls(ControlSettings(gain=1), ioctl).problems


def test_a_file_that_is_no_camera_has_no_controls(tmp_path: Path) -> None:
    """A real ioctl: the kernel says ENOTTY of any device that is none of V4L2's."""
    found = _apply_controls(Path("/dev/null"), ControlSettings(gain=1))
    assert found.problems[0].startswith("gain: expected a camera that can set it")
    assert _apply_controls(tmp_path / "none", ControlSettings()).problems
