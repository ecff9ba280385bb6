# SPDX-License-Identifier: Apache-2.0
"""Frames through OpenCV: V4L2 devices, video files, RTSP; and folders of images."""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from softgrip_time.units import to_ns
from softgrip_vision.errors import SourceError
from softgrip_vision.frame import CameraFrame
from softgrip_vision.v4l2_controls import ControlReport, ControlSettings, apply_controls

IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp"})
DEFAULT_FILE_FPS = 30.0
#: [ms] A buffer's time further back than this is not on the monotonic clock.
OLDEST_BUFFER_MS = 1000.0


class DeviceStream:
    """A V4L2 device.

    A frame's stamp is the time that the driver gave its buffer (CAP_PROP_POS_MSEC, on the monotonic clock, to the
    millisecond); where it gave none, the time at which the grab returned.

    Args:
        path: e.g. /dev/video0.
        width, height: [px] asked for; 0 = the device's choice.
        fps: [Hz] asked for; 0 = the device's choice.
        now_ns: clock of the stamps.
        monotonic_ns: clock of the buffers.
        controls: to set before the first frame.

    Attributes:
        controls: what came of them.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        fps: float,
        now_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        controls: ControlSettings | None = None,
    ) -> None:
        _require_access(path)
        self._path, self._now_ns, self._monotonic_ns = path, now_ns, monotonic_ns
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise SourceError(f"{path}: expected a V4L2 camera, found a device that cannot be opened; is it in use?")
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, width),
            (cv2.CAP_PROP_FRAME_HEIGHT, height),
            (cv2.CAP_PROP_FPS, fps),
        ):
            if value:
                self._capture.set(key, value)
        self.controls = _apply_controls(path, controls or ControlSettings())

    def read(self) -> CameraFrame | None:
        """Return the next frame."""
        grabbed = self._capture.grab()
        stamp = self._now_ns() - self._age_ns()
        done, image = self._capture.retrieve() if grabbed else (False, None)
        if not done or image is None:
            raise SourceError(f"{self._path}: the camera gave no frame; was it unplugged?")
        return CameraFrame(stamp, image.shape[1], image.shape[0], image=np.asarray(image, dtype=np.uint8))

    def _age_ns(self) -> int:
        """Return how long ago [ns] the frame just grabbed was captured; 0 when the driver does not tell."""
        age_ms = self._monotonic_ns() * 1e-6 - float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        return round(age_ms * 1e6) if 0.0 <= age_ms < OLDEST_BUFFER_MS else 0

    def close(self) -> None:
        """Release the device."""
        self._capture.release()


class VideoStream:
    """A video file or an RTSP stream.

    A file's frames are stamped with its own time line, counted from ``start_ns``; a live stream's with their arrival.

    Args:
        target: path or rtsp:// URL.
        live: whether it is a stream.
        timeout: [s] without data after which a stream counts as dead.
        start_ns: [ns] time of a file's first frame.
        now_ns: clock of a live stream's stamps.
    """

    def __init__(
        self,
        target: str,
        *,
        live: bool,
        timeout: float = 2.0,
        start_ns: int = 0,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        if not live:
            _require_access(Path(target))
        self._target, self._live, self._now_ns = target, live, now_ns
        limit_ms = round(timeout * 1e3)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms] if live else []
        self._capture = cv2.VideoCapture(target, cv2.CAP_FFMPEG, limits)
        if not self._capture.isOpened():
            what = "a stream" if live else "a video"
            raise SourceError(
                f"{target}: expected {what} that FFmpeg can read, found none (corrupt, or another format)"
            )
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = fps if 0 < fps < 1000 else DEFAULT_FILE_FPS
        self.frame_count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self._start_ns = start_ns
        self._index = 0

    def read(self) -> CameraFrame | None:
        """Return the next frame; None at the end."""
        done, image = self._capture.read()
        if not done or image is None:
            if self._index == 0:
                raise SourceError(f"{self._target}: expected frames, found none that can be decoded")
            return None
        stamp = self._now_ns() if self._live else self._start_ns + to_ns(self._index / self.fps)
        self._index += 1
        return CameraFrame(stamp, image.shape[1], image.shape[0], image=np.asarray(image, dtype=np.uint8))

    def close(self) -> None:
        """Close the file or stream."""
        self._capture.release()


class FolderStream:
    """The images of a folder in the order of their names, at a fixed rate.

    Args:
        folder: with image files.
        fps: [Hz] of the time line.
        start_ns: [ns] time of the first image.
    """

    def __init__(self, folder: Path, fps: float, start_ns: int = 0) -> None:
        _require_access(folder)
        self._files = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if not self._files:
            raise SourceError(f"{folder}: expected images ({', '.join(sorted(IMAGE_SUFFIXES))}), found none")
        self.fps = fps or DEFAULT_FILE_FPS
        self.frame_count = len(self._files)
        self._start_ns = start_ns
        self._index = 0

    def read(self) -> CameraFrame | None:
        """Return the next image; None after the last."""
        if self._index == len(self._files):
            return None
        path = self._files[self._index]
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise SourceError(f"{path}: expected an image, found a file that is none; remove it from the folder")
        stamp = self._start_ns + to_ns(self._index / self.fps)
        self._index += 1
        return CameraFrame(stamp, image.shape[1], image.shape[0], image=np.asarray(image, dtype=np.uint8))

    def close(self) -> None:
        """Nothing is open between images."""


def _apply_controls(path: Path, settings: ControlSettings) -> ControlReport:
    """Set the controls through a descriptor of their own: V4L2 lets several have a device open, one of them stream."""

    def ioctl(request: int, data: bytes) -> bytes:
        buffer = bytearray(data)
        fcntl.ioctl(descriptor, request, buffer)
        return bytes(buffer)

    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        return ControlReport({}, (f"{path}: expected to set its controls, found: {error}",), ())
    try:
        return apply_controls(settings, ioctl)
    finally:
        os.close(descriptor)


def _require_access(path: Path) -> None:
    """Return why a path cannot be read, which OpenCV does not."""
    if not path.exists():
        raise SourceError(
            f"{path}: expected a camera, video or folder, found nothing there ({os.strerror(errno.ENOENT)})"
        )
    if not os.access(path, os.R_OK):
        raise SourceError(
            f"{path}: expected to be allowed to read it, found: {os.strerror(errno.EACCES)}; "
            "for a camera, add the user to the group 'video'"
        )
