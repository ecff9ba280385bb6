# SPDX-License-Identifier: Apache-2.0
"""JPEG and PNG as they come from cameras, bags and strangers: decoded only after a look at the size that they claim."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.errors import FrameError

Image = NDArray[np.uint8]

#: JPEG start-of-frame markers (ITU-T T.81 table B.1): C0..CF without DHT (C4), JPG (C8), DAC (CC).
START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
#: Markers without a length: TEM, RST0..7, SOI, EOI.
STAND_ALONE = frozenset({0x01, *range(0xD0, 0xDA)})
#: [px] An industrial camera has 25 million at most; some hundred bytes of PNG can claim a thousand times as many.
MAX_PIXELS = 32_000_000
_PNG = b"\x89PNG\r\n\x1a\n"


def decode(data: bytes | bytearray | memoryview) -> Image:
    """Return the (h, w, 3) BGR image of a JPEG or PNG, after a look at the size that its header claims.

    Raises:
        FrameError: when the bytes are no JPEG or PNG, or claim more than MAX_PIXELS.
    """
    return _decoded(data, cv2.IMREAD_COLOR)


def thumbnail(data: bytes) -> Image:
    """Return the (h / 8, w / 8) grey image of a JPEG or PNG; of a JPEG without computing the other pixels.

    Raises:
        FrameError: as `decode`.
    """
    return _decoded(data, cv2.IMREAD_REDUCED_GRAYSCALE_8)


def thumbnail_of(image: Image) -> Image:
    """Return the (h / 8, w / 8) grey image of an (h, w, 3) BGR one."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (max(1, width // 8), max(1, height // 8)), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _decoded(data: bytes | bytearray | memoryview, mode: int) -> Image:
    raw = np.frombuffer(data, dtype=np.uint8)
    claimed = image_size(raw.tobytes())
    if claimed[0] * claimed[1] > MAX_PIXELS:
        raise FrameError(f"expected an image of {MAX_PIXELS} pixels at most, found {claimed[0]}x{claimed[1]}")
    image = None
    if raw.size:
        try:
            image = cv2.imdecode(raw, mode)
        except cv2.error as error:
            raise FrameError(f"expected a compressed image, found {raw.size} bytes: {error.err}") from error
    if image is None:
        raise FrameError(f"expected a compressed image (JPEG, PNG), found {raw.size} bytes that are none")
    return np.asarray(image, dtype=np.uint8)


def image_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) [px] that a JPEG or PNG claims, without decoding it.

    Raises:
        FrameError: when the bytes are neither.
    """
    if data[:8] == _PNG and data[12:16] == b"IHDR" and len(data) >= 24:  # PNG (ISO 15948) 11.2.2
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if data[:2] != b"\xff\xd8":
        raise FrameError(f"expected a compressed image (JPEG, PNG), found {len(data)} bytes that are none")
    return jpeg_size(data)


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) [px] of a JPEG from its start-of-frame segment (ITU-T T.81 B.2.2), without decoding it.

    Raises:
        FrameError: when the bytes are no JPEG or end before the segment.
    """
    if data[:2] != b"\xff\xd8":
        raise FrameError(f"expected a JPEG (bytes ff d8), found {data[:2].hex(' ') or 'nothing'}")
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise FrameError(f"expected a JPEG marker at byte {at}, found {data[at]:02x}")
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
        elif marker in STAND_ALONE:
            at += 2
        elif marker in START_OF_FRAME and at + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    raise FrameError(f"expected a compressed image: a JPEG with a frame header, found {len(data)} bytes without one")
