# SPDX-License-Identifier: Apache-2.0
"""Between this package's values and messages; its one home."""

from __future__ import annotations

import array
import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from softgrip_interfaces.msg import FingerMarkers, FingerState, FingerStates, Marker
from softgrip_vision import colour
from softgrip_vision.calibration import CameraCalibration
from softgrip_vision.errors import FrameError
from softgrip_vision.frame import CameraFrame
from softgrip_vision.readings import FingerReading, MarkerReading

#: Channel order of the raw encodings that a colour camera publishes; index of B, G, R in a pixel, and its bytes.
RAW_ENCODINGS = {"bgr8": ((0, 1, 2), 3), "rgb8": ((2, 1, 0), 3), "bgra8": ((0, 1, 2), 4), "rgba8": ((2, 1, 0), 4)}


def to_image_message(image: colour.Image, header: Header) -> Image:
    """Return an (h, w, 3) BGR image as a message."""
    height, width = image.shape[:2]
    data = array.array("B", np.ascontiguousarray(image).tobytes())
    return Image(header=header, height=height, width=width, encoding="bgr8", is_bigendian=0, step=width * 3, data=data)


def to_compressed_message(frame: CameraFrame, quality: int, header: Header) -> CompressedImage:
    """Return a frame as JPEG; bytes that came as JPEG pass untouched."""
    return CompressedImage(
        header=header, format="bgr8; jpeg compressed bgr8", data=array.array("B", frame.encoded(quality))
    )


def to_camera_info(calibration: CameraCalibration | None, width: int, height: int, header: Header) -> CameraInfo:
    """Return the camera info of a frame; K is zero, which ROS reads as uncalibrated, without a fitting calibration."""
    info = CameraInfo(header=header, width=width, height=height)
    if calibration is None or (calibration.lens.width, calibration.lens.height) != (width, height):
        return info
    lens = calibration.lens
    info.distortion_model = lens.distortion_model
    info.d = [float(value) for value in lens.distortion]
    info.k = [float(value) for value in lens.matrix.ravel()]
    info.r = [float(value) for value in np.eye(3).ravel()]
    info.p = [float(value) for value in np.hstack([lens.matrix, np.zeros((3, 1))]).ravel()]
    return info


def from_image_message(message: Image) -> colour.Image:
    """Return the (h, w, 3) BGR image of a raw image message.

    Raises:
        FrameError: when the encoding carries no colour or the data do not fill the image.
    """
    if message.encoding not in RAW_ENCODINGS:
        raise FrameError(f"expected a colour image ({', '.join(RAW_ENCODINGS)}), found encoding '{message.encoding}'")
    order, channels = RAW_ENCODINGS[message.encoding]
    raw = np.frombuffer(message.data, dtype=np.uint8)
    if message.step < message.width * channels or raw.size != message.step * message.height or not raw.size:
        raise FrameError(
            f"expected {message.width}x{message.height} pixels of {channels} bytes, found {raw.size} bytes in rows of "
            f"{message.step}"
        )
    rows = raw.reshape(message.height, message.step)[:, : message.width * channels]
    pixels = rows.reshape(message.height, message.width, channels)
    return pixels if order == (0, 1, 2) and channels == 3 else np.ascontiguousarray(pixels[:, :, order])


def to_markers_message(reading: FingerReading, configuration: str, header: Header) -> FingerMarkers:
    """Return one finger's markers, and the digest of what they were found with."""
    return FingerMarkers(
        header=header,
        finger=reading.finger,
        markers=[_to_marker(marker) for marker in reading.markers],
        threshold_quality=float(reading.threshold_quality),
        configuration=configuration,
    )


def _to_marker(marker: MarkerReading) -> Marker:
    return Marker(
        name=marker.name,
        u=float(marker.pixel[0]),
        v=float(marker.pixel[1]),
        x=float(marker.point[0]),
        y=float(marker.point[1]),
        stddev=float(marker.stddev_px),
        confidence=float(marker.confidence),
        occluded=bool(marker.occluded),
    )


def to_states_message(readings: Sequence[FingerReading], configuration: str, header: Header) -> FingerStates | None:
    """Return the fingers whose pose is known; None when there is none: silent rather than wrong."""
    fingers = [_to_state(reading) for reading in readings if reading.pose is not None]
    if not fingers:
        return None
    return FingerStates(header=header, fingers=fingers, friction_model="", configuration=configuration)


def _to_state(reading: FingerReading) -> FingerState:
    pose = reading.pose
    assert pose is not None
    return FingerState(
        finger=reading.finger,
        profile=reading.profile,
        pulled_length=math.nan,
        tension=math.nan,
        joint_angles=[float(angle) for angle in pose.angles],
        joint_angles_stddev=[float(deviation) for deviation in pose.angles_stddev],
        tip=Point(x=float(pose.tip[0]), y=float(pose.tip[1]), z=0.0),
        tip_stddev=[float(deviation) for deviation in pose.tip_stddev],
        contact_tensions=[],
        validity=FingerState.OK,
        reason="",
    )


def to_header(stamp: Time, frame: str) -> Header:
    """Return a header."""
    return Header(stamp=stamp, frame_id=frame)
