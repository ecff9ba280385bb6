# SPDX-License-Identifier: Apache-2.0
"""One frame: as the JPEG it came as, or as pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2

from softgrip_vision.colour import Image
from softgrip_vision.encoded_image import decode
from softgrip_vision.errors import FrameError


@dataclass(frozen=True)
class CameraFrame:
    """A captured frame; exactly one of ``jpeg`` and ``image`` is there.

    Attributes:
        stamp_ns: [ns] time of capture since the epoch.
        width, height: [px].
        jpeg: the file's bytes, untouched.
        image: (h, w, 3) BGR.
    """

    stamp_ns: int
    width: int
    height: int
    jpeg: bytes | None = None
    image: Image | None = None

    def pixels(self) -> Image:
        """Return the (h, w, 3) BGR image.

        Raises:
            FrameError: when the JPEG cannot be decoded.
        """
        if self.image is not None:
            return self.image
        assert self.jpeg is not None
        return decode(self.jpeg)

    def encoded(self, quality: int) -> bytes:
        """Return the JPEG; one that came as JPEG is passed on as it is."""
        if self.jpeg is not None:
            return self.jpeg
        assert self.image is not None
        done, data = cv2.imencode(".jpg", self.image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not done:
            raise FrameError(f"expected an image that JPEG can hold, found {self.width}x{self.height}")
        return bytes(data)


class FrameSource(Protocol):
    """Anything that gives frames, one after the other."""

    def read(self) -> CameraFrame | None:
        """Wait for the next frame; None at the end of a source that has one. Raises SourceError."""

    def close(self) -> None:
        """Let go of whatever is open."""
