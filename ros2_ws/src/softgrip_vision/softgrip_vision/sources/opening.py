# SPDX-License-Identifier: Apache-2.0
"""From what the user wrote to an open source."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from urllib.parse import urlsplit

from softgrip_vision.errors import SourceError
from softgrip_vision.frame import FrameSource
from softgrip_vision.sources.mjpeg import MjpegStream
from softgrip_vision.sources.opencv import DeviceStream, FolderStream, VideoStream
from softgrip_vision.v4l2_controls import ControlSettings


class SourceKind(Enum):
    """What a source is."""

    DEVICE = "device"
    VIDEO = "video"
    FOLDER = "folder"
    MJPEG = "mjpeg"
    RTSP = "rtsp"
    REFERENCE = "reference"


@dataclass(frozen=True)
class SourceOptions:
    """How to open it.

    Attributes:
        width, height: [px] asked of a device; 0 = its choice.
        fps: [Hz] asked of a device, or of a folder's time line; 0 = their choice.
        timeout: [s] without data after which a stream counts as dead.
        controls: to set of a device.
    """

    width: int = 0
    height: int = 0
    fps: float = 0.0
    timeout: float = 2.0
    controls: ControlSettings = field(default_factory=ControlSettings)


def kind_of(source: str) -> SourceKind:
    """Return what a source is, from how it is written and, for a path, what is there.

    Raises:
        SourceError: when it is empty or a URL of another scheme.
    """
    if not source:
        raise SourceError("expected a source: device number or path, video file, folder, URL, or @file; found ''")
    if source.startswith("@"):
        return SourceKind.REFERENCE
    scheme = urlsplit(source).scheme.lower() if "://" in source else ""
    if scheme in {"http", "https"}:
        return SourceKind.MJPEG
    if scheme in {"rtsp", "rtsps", "rtmp"}:
        return SourceKind.RTSP
    if scheme:
        raise SourceError(f"expected http, https or rtsp, found the scheme '{scheme}' in '{source}'")
    if source.isdigit() or Path(source).is_char_device():
        return SourceKind.DEVICE
    return SourceKind.FOLDER if Path(source).is_dir() else SourceKind.VIDEO


def dereference(source: str) -> str | None:
    """Return the source named in the file of ``@file``; None while the file is not there or empty."""
    path = Path(source.removeprefix("@"))
    try:
        named = path.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path}: expected a file that names the camera, found: {error}") from error
    if named.startswith("@"):
        raise SourceError(f"{path}: expected a device, file or URL, found another reference '{named}'")
    return named or None


def open_source(source: str, options: SourceOptions | None = None, start_ns: int | None = None) -> FrameSource:
    """Open a device, video file, folder or URL (not ``@file``: see :func:`dereference`).

    Args:
        source: as written by the user.
        options: how.
        start_ns: [ns] time of a file's first frame; None = now.

    Raises:
        SourceError: when that cannot be done; the message says why.
    """
    options = options or SourceOptions()
    start = time.time_ns() if start_ns is None else start_ns
    match kind_of(source):
        case SourceKind.DEVICE:
            path = Path(f"/dev/video{source}") if source.isdigit() else Path(source)
            return DeviceStream(path, options.width, options.height, options.fps, controls=options.controls)
        case SourceKind.FOLDER:
            return FolderStream(Path(source), options.fps, start)
        case SourceKind.MJPEG:
            return MjpegStream(source, options.timeout)
        case SourceKind.RTSP:
            return VideoStream(source, live=True, timeout=options.timeout)
        case SourceKind.VIDEO:
            return VideoStream(source, live=False, start_ns=start)
        case SourceKind.REFERENCE:
            raise SourceError(f"expected a device, file or URL, found the reference '{source}'")
