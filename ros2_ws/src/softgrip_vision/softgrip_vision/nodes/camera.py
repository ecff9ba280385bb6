# SPDX-License-Identifier: Apache-2.0
"""Publishes a camera's frames: JPEG always (bags stay small), raw pixels on request, camera info with each.

Topics (relative): camera/image_raw/compressed, camera/image_raw (parameter publish_raw), camera/camera_info.
Stamps are the time of capture. A stock ROS 2 camera driver with the same topics may take this node's place.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import cv2
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from softgrip_description.geometry import quaternion_of
from softgrip_nodekit import (
    LATCHED,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    Rank,
    StartupError,
    realtime_parameter,
    run,
    startup_errors,
    steady_timer,
    to_time_message,
    transform_message,
)
from softgrip_time.units import to_s
from softgrip_vision import calibration
from softgrip_vision.calibration import file_when_there
from softgrip_vision.camera_pose import camera_pose
from softgrip_vision.errors import CalibrationError, FrameError, VisionError
from softgrip_vision.frame_watch import FirstFrameWatch, FrameWatch
from softgrip_vision.nodes import convert
from softgrip_vision.sources import CameraFrame, Capture, CaptureState, CaptureStatus, SourceOptions
from softgrip_vision.v4l2_controls import LEAVE, POWER_LINE, ControlSettings

PARAMETERS = ParameterTable(
    Parameter(
        "source",
        "0",
        "device number or path, video file, image folder, http(s) motion-JPEG or rtsp URL, or @FILE: the source is "
        "named in FILE, which may appear later; none: a bench without camera",
    ),
    Parameter("frame_id", "camera_optical_frame", "optical frame of the images (z forward, x right, y down)"),
    Parameter("frame_prefix", "", "before frame_id: that of hand_description"),
    Parameter("calibration_file", "", "camera calibration (YAML); empty: camera_info says uncalibrated"),
    Parameter(
        "lens_file",
        "",
        "where camera/set_camera_info writes the lens (camera_calibration); empty: it refuses. `calibrate_camera plane "
        "--calibration` adds the fingers' planes to this file",
    ),
    Parameter("calibration_wait_s", 8.0, "how long a calibration file may take to appear at start", "s", 0.0, 60.0),
    Parameter("publish_raw", False, "also publish camera/image_raw (uncompressed)"),
    Parameter("jpeg_quality", 90, "of frames that do not come as JPEG", "%", 50, 100, changeable=True),
    Parameter("width", 0, "asked of a device; 0: its choice", "px", 0, 8192),
    Parameter("height", 0, "asked of a device; 0: its choice", "px", 0, 8192),
    Parameter("fps", 0.0, "asked of a device, or of an image folder; 0: their choice", "Hz", 0.0, 1000.0),
    Parameter("exposure_s", 0.0, "of a V4L2 device; 0: the camera chooses it again with the light", "s", 0.0, 1.0),
    Parameter("gain", LEAVE, "of a V4L2 device, in its own unit (v4l2-ctl -l); -1: as it is", "", LEAVE, 2**31 - 1),
    Parameter("focus", LEAVE, "likewise; -1: as it is, automatic where it can", "", LEAVE, 2**31 - 1),
    Parameter("white_balance_k", 0, "of a V4L2 device; 0: the camera chooses it", "K", 0, 20000),
    Parameter(
        "power_line_hz",
        LEAVE,
        "of the lamps, which flicker at twice that; 0: none, -1: as it is",
        "Hz",
        choices=(LEAVE, *POWER_LINE),
    ),
    Parameter(
        "wait_for",
        "",
        "nodes, separated by commas, that must subscribe before the first frame: a bag that lacks frames cannot show "
        "what the tracker made of them",
    ),
    Parameter("wait_limit_s", 5.0, "longest wait for them", "s", 0.0, 60.0),
    Parameter("timeout_s", 2.0, "a stream without data for so long is reconnected", "s", 0.1, 60.0),
    Parameter("reconnect_delay_s", 0.5, "between attempts to connect", "s", 0.05, 60.0),
    Parameter("repeat", False, "start a file or folder again at its end"),
    Parameter("queue_depth", 2, "frames kept when the node is busy; older ones are dropped", "", 1, 30),
    Parameter(
        "first_frame_s",
        10.0,
        "a camera may take so long to its first frame before that is an error on /diagnostics",
        "s",
        0.5,
        120.0,
    ),
    Parameter("stale_after_s", 1.0, "a newest frame older than this is an error on /diagnostics", "s", 0.05, 60.0),
    realtime_parameter(Rank.ORDINARY),
)

#: The source of a bench that has none.
NO_CAMERA = "none"
#: OpenCV's log level of errors.
OPENCV_ERRORS = 2
#: [s] between looks at the health of the capture.
HEALTH_PERIOD = 0.5
#: [s] between looks at who subscribes. The middleware knows of a subscription a little before samples reach it.
LISTENERS_PERIOD = 0.05
COMPLETE_CHECKS = 3


class CameraNode(CellNode):
    """The camera node."""

    def __init__(self) -> None:
        super().__init__("camera")
        self._values = PARAMETERS.declare(self)
        PARAMETERS.on_change(self, self._values.update)
        if self._values["source"] == NO_CAMERA:
            self._diagnostics = Diagnostics(self)
            self._diagnostics.set("capture", Health.OK, "this bench has no camera (source: none)")
            return
        self._calibration = self._load_calibration()
        self._diagnostics = Diagnostics(self, self._calibration.camera_serial if self._calibration else "")
        self._compressed = self.create_publisher(CompressedImage, "camera/image_raw/compressed", SENSOR)
        self._pixels = self.create_publisher(Image, "camera/image_raw", SENSOR) if self._values["publish_raw"] else None
        self._camera_info = self.create_publisher(CameraInfo, "camera/camera_info", SENSOR)
        # the name that camera_calibration's cameracalibrator calls with camera:=camera
        self.create_service(SetCameraInfo, "camera/set_camera_info", self._on_set_camera_info)
        self._frame = f"{self._values['frame_prefix']}{self._values['frame_id']}"
        self._transforms = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._publish_pose()
        self._frames_ready = self.create_guard_condition(self._publish_ready)
        self._info = CameraInfo()
        self._published = 0
        self._last_stamp_ns = 0
        self._size_problem = ""
        self._first_frame = FirstFrameWatch(self._values["first_frame_s"])
        self._watch = FrameWatch()
        self._capture = self._make_capture()
        self._expected = {name.strip() for name in self._values["wait_for"].split(",")} - {""}
        self._waited_s = 0.0
        self._complete_checks = 0
        self._waiting = steady_timer(self, LISTENERS_PERIOD, self._await_listeners)
        steady_timer(self, HEALTH_PERIOD, self._report)

    def _load_calibration(self) -> calibration.CameraCalibration | None:
        name = self._values["calibration_file"]
        if not name:
            return None
        with startup_errors(VisionError):
            return calibration.load(file_when_there(Path(name), self._values["calibration_wait_s"]))

    def _publish_pose(self) -> None:
        """Log where the camera stands, where its calibration knows: beside the first finger that it names."""
        if self._calibration is None or not self._calibration.planes:
            return
        plane = self._calibration.planes[0]
        base, pose = f"{self._values['frame_prefix']}{plane.finger}_base", camera_pose(self._calibration.lens, plane)
        now = self.get_clock().now().to_msg()
        transform = transform_message(now, base, self._frame, pose[:3, 3], quaternion_of(pose))
        self._transforms.publish(TFMessage(transforms=[transform]))

    def _make_capture(self) -> Capture:
        value = self._values
        controls = ControlSettings(
            value["exposure_s"], value["gain"], value["focus"], value["white_balance_k"], value["power_line_hz"]
        )
        options = SourceOptions(value["width"], value["height"], value["fps"], value["timeout_s"], controls)
        try:
            return Capture(
                value["source"],
                options,
                self._frames_ready.trigger,
                depth=value["queue_depth"],
                reconnect_delay=value["reconnect_delay_s"],
                repeat=value["repeat"],
            )
        except VisionError as error:
            raise StartupError(f"parameter 'source': {error}") from error

    def _await_listeners(self) -> None:
        self._waited_s += LISTENERS_PERIOD
        missing = self._expected - self._listeners() if self._expected else set()
        self._complete_checks = 0 if missing else self._complete_checks + 1
        late = self._waited_s >= self._values["wait_limit_s"]
        if self._expected and self._complete_checks < COMPLETE_CHECKS and not late:
            return
        if missing:
            self.get_logger().warning(
                f"expected a subscription of {', '.join(sorted(missing))} to {self._compressed.topic_name} within "
                f"{self._values['wait_limit_s']:g} s, found none; starting without"
            )
        self._waiting.cancel()
        self._capture.start()

    def _listeners(self) -> set[str]:
        return {info.node_name for info in self.get_subscriptions_info_by_topic(self._compressed.topic_name)}

    def _publish_ready(self) -> None:
        while (frame := self._capture.take_frame()) is not None:
            self._publish(frame)

    def _publish(self, frame: CameraFrame) -> None:
        header = convert.to_header(to_time_message(frame.stamp_ns), self._frame)
        self._size_problem = self._check_size(frame)
        try:
            compressed = convert.to_compressed_message(frame, self._values["jpeg_quality"], header)
            raw = convert.to_image_message(frame.pixels(), header) if self._pixels is not None else None
        except FrameError as error:
            self._diagnostics.set("frames", Health.ERROR, str(error))
            return
        self._camera_info.publish(self._info_of(frame, header))
        self._compressed.publish(compressed)
        if self._pixels is not None and raw is not None:
            self._pixels.publish(raw)
        self._watch.observe_frame(frame)
        self._published += 1
        self._last_stamp_ns = frame.stamp_ns

    def _info_of(self, frame: CameraFrame, header: Header) -> CameraInfo:
        """Return the camera info of a frame: all but its header stays the same while frames keep their size."""
        if (self._info.width, self._info.height) != (frame.width, frame.height):
            self._info = convert.to_camera_info(self._calibration, frame.width, frame.height, header)
        self._info.header = header
        return self._info

    def _on_set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        info = request.camera_info
        try:
            response.status_message = self._set_lens(info)
            response.success = True
        except (VisionError, OSError) as error:
            response.status_message = str(error)
        return response

    def _set_lens(self, info: CameraInfo) -> str:
        """Write a lens; use it at once where no planes depend on another one. Return what was done."""
        name = self._values["lens_file"]
        if not name:
            raise CalibrationError("expected parameter lens_file, found none; name a file to write the lens to")
        size = (int(info.width), int(info.height))
        frames = (int(self._info.width), int(self._info.height))
        if self._published and size != frames:
            raise CalibrationError(f"expected a lens for images of {frames[0]}x{frames[1]}, found {size[0]}x{size[1]}")
        lens = calibration.lens_from_camera_info(size, info.distortion_model, info.k, info.d, "camera")
        date = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        found = calibration.CameraCalibration(lens, (), date, "unknown", math.nan, 0)
        calibration.save(found, Path(name))
        if self._calibration is not None and self._calibration.planes:
            return f"written to {name}; in use stays calibration_file, whose planes belong to its own lens"
        self._calibration, self._info = found, CameraInfo()
        return f"written to {name} and in use; next: calibrate_camera plane --calibration {name}"

    def _check_size(self, frame: CameraFrame) -> str:
        if self._calibration is None:
            return ""
        try:
            self._calibration.require_size(frame.width, frame.height)
        except VisionError as error:
            return str(error)
        return ""

    def _report(self) -> None:
        status = self._capture.status
        age = to_s(self.get_clock().now().nanoseconds - self._last_stamp_ns) if self._published else float("inf")
        health, message = self._judge(status, age)
        values: dict[str, object] = {
            "state": status.state.value,
            "frame_age_s": f"{age:.4f}",
            "frames_captured": status.frames,
            "frames_published": self._published,
            "frames_dropped": status.dropped,
            "connections": status.connections,
        }
        self._diagnostics.set("capture", health, message, values)
        self._report_controls(status)
        problem = self._watch.problem()
        self._diagnostics.set("picture", Health.ERROR if problem else Health.OK, problem or "alive and lit")
        if self._size_problem:
            self._diagnostics.set("frames", Health.ERROR, self._size_problem)
        elif self._published:
            self._diagnostics.set(
                "frames", Health.OK, "of the calibrated size" if self._calibration else "uncalibrated"
            )

    def _report_controls(self, status: CaptureStatus) -> None:
        """Log what a device could not be set to, and what it still chooses by itself."""
        found = status.controls
        if found is None:
            return
        texts = list(found.problems)
        if found.automatic:
            texts.append(
                f"the camera chooses {', '.join(found.automatic)} by itself: markers move with the light; set "
                "exposure_s, white_balance_k, focus"
            )
        self._diagnostics.set(
            "controls", Health.WARN if texts else Health.OK, "; ".join(texts) or "set by hand", found.values
        )

    def _judge(self, status: CaptureStatus, age: float) -> tuple[Health, str]:
        if status.state is CaptureState.BROKEN:
            return Health.ERROR, status.message
        if status.state is CaptureState.ENDED:
            return Health.WARN, status.message
        what = f"{status.state.value}: {status.message}"
        if not self._published and status.state is not CaptureState.WAITING:
            return self._judge_start(what)
        if status.state in {CaptureState.WAITING, CaptureState.CONNECTING}:
            return Health.WARN, what
        if age > self._values["stale_after_s"]:
            return Health.ERROR, f"expected frames younger than {self._values['stale_after_s']:g} s, found {age:.1f} s"
        return Health.OK, status.message

    def _judge_start(self, what: str) -> tuple[Health, str]:
        """Return how the camera is before its first frame."""
        if not self._waiting.is_canceled():
            return Health.STALE, "no frame yet, waiting for the nodes of parameter wait_for"
        problem = self._first_frame.problem(time.monotonic())
        return (Health.ERROR, f"{problem} ({what})") if problem else (Health.STALE, f"no frame yet, waiting ({what})")

    def close(self) -> None:
        """Stop capturing and let go of the device."""
        if self._values["source"] != NO_CAMERA:
            self._capture.stop()


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    # OpenCV would warn of every attempt to connect; /diagnostics says why, once.
    # OpenCV 4.14 has it here only, that of Ubuntu 24.04 (4.6) one level up
    getattr(cv2.utils, "logging", cv2).setLogLevel(OPENCV_ERRORS)
    sys.exit(run(CameraNode, args))


if __name__ == "__main__":
    main()
