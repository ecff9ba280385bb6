# SPDX-License-Identifier: Apache-2.0
"""Where frames come from: device, file, folder, stream. The only modules of this package that open any."""

from softgrip_vision.encoded_image import decode, image_size, jpeg_size
from softgrip_vision.frame import CameraFrame
from softgrip_vision.sources.capture import Capture, CaptureState, CaptureStatus
from softgrip_vision.sources.opening import SourceOptions, kind_of, open_source

__all__ = [
    "CameraFrame",
    "Capture",
    "CaptureState",
    "CaptureStatus",
    "SourceOptions",
    "decode",
    "image_size",
    "jpeg_size",
    "kind_of",
    "open_source",
]
