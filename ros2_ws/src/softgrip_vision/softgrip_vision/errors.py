# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with what the camera side is given. Every message: expected, found, what to do."""


class VisionError(Exception):
    """Base of this package's errors."""


class CalibrationError(VisionError):
    """A calibration file, or a set of calibration views, cannot be used."""


class FrameError(VisionError):
    """A frame cannot be measured: wrong size, not colour, or not an image at all."""


class SourceError(VisionError):
    """A camera, file, folder or stream cannot be read."""


class LayoutError(VisionError):
    """A description of the markers on a finger makes no sense."""
