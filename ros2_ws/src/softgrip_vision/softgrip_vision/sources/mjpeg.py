# SPDX-License-Identifier: Apache-2.0
"""Motion JPEG over HTTP (multipart/x-mixed-replace): parts in, frames out.

A part's header ``X-Timestamp`` (seconds since the epoch, as mjpg-streamer and the cell's emulator send it) is its time
of capture. Without one the time of arrival stands in.
"""

from __future__ import annotations

import http.client
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from decimal import Decimal, InvalidOperation
from email.message import Message
from typing import Protocol

from softgrip_time.units import NANOSECONDS
from softgrip_vision.encoded_image import jpeg_size
from softgrip_vision.errors import FrameError, SourceError
from softgrip_vision.frame import CameraFrame

#: A part's header block and a part are refused beyond these sizes [bytes].
LONGEST_HEADER = 16_384
LARGEST_PART = 64 * 1024 * 1024
TIMESTAMP = "x-timestamp"


class ByteReader(Protocol):
    """What the parser needs of a stream."""

    def readline(self, limit: int = -1, /) -> bytes:
        """Return one line with its end."""

    def read(self, size: int = -1, /) -> bytes:
        """Return up to ``size`` bytes."""


def boundary_of(content_type: str) -> bytes:
    """Return the boundary named by a multipart content type.

    Raises:
        SourceError: when it is not multipart or names none.
    """
    match = re.match(r'\s*multipart/[^;]+;.*?boundary="?([^";,]+)"?', content_type, re.IGNORECASE)
    if match is None:
        raise SourceError(
            f"expected a motion-JPEG stream (multipart/x-mixed-replace with a boundary), found '{content_type}'"
        )
    return match.group(1).strip().encode("latin-1")


class PartReader:
    """Reads parts of a multipart body.

    Args:
        stream: the body.
        boundary: between parts, with or without its leading dashes.
    """

    def __init__(self, stream: ByteReader, boundary: bytes) -> None:
        self._stream = stream
        self._delimiter = b"--" + boundary.removeprefix(b"--")

    def next_part(self) -> tuple[dict[str, str], bytes] | None:
        """Return the next part as (headers with lower-case names, body); None at the end of the stream.

        Raises:
            SourceError: when the stream is no multipart body or ends within a part.
        """
        if not self._to_delimiter():
            return None
        headers = self._headers()
        if "content-length" in headers:
            return headers, self._exactly(headers["content-length"])
        return headers, self._until_delimiter()

    def _to_delimiter(self) -> bool:
        skipped = 0
        while line := self._stream.readline(LONGEST_HEADER):
            text = line.rstrip(b"\r\n")
            if text == self._delimiter:
                return True
            if text == self._delimiter + b"--":
                return False
            skipped += len(line)
            if skipped > LARGEST_PART:
                raise SourceError(f"expected '{self._delimiter.decode('latin-1')}', found {skipped} bytes without it")
        return False

    def _headers(self) -> dict[str, str]:
        headers: dict[str, str] = {}
        size = 0
        while line := self._stream.readline(LONGEST_HEADER):
            size += len(line)
            text = line.strip()
            if not text:
                return headers
            name, colon, value = text.decode("latin-1").partition(":")
            if not colon or size > LONGEST_HEADER:
                raise SourceError(f"expected a part's header lines, found {text[:60]!r}")
            headers[name.strip().lower()] = value.strip()
        raise SourceError("expected a part's headers, found the end of the stream")

    def _exactly(self, length_text: str) -> bytes:
        if not length_text.isdigit() or int(length_text) > LARGEST_PART:
            raise SourceError(f"expected a Content-Length of 0 .. {LARGEST_PART}, found '{length_text}'")
        requested = int(length_text)
        pieces: list[bytes] = []
        while requested:
            piece = self._stream.read(requested)
            if not piece:
                raise SourceError(f"expected {length_text} bytes in a part, found the stream's end {requested} short")
            pieces.append(piece)
            requested -= len(piece)
        return b"".join(pieces)

    def _until_delimiter(self) -> bytes:
        """Read a part without length: it ends where its JPEG does (bytes ff d9 before a line end)."""
        body = bytearray()
        while line := self._stream.readline(LARGEST_PART):
            body += line
            if body.rstrip(b"\r\n").endswith(b"\xff\xd9"):
                return bytes(body.rstrip(b"\r\n"))
            if len(body) > LARGEST_PART:
                break
        raise SourceError(f"expected the end of a JPEG part, found {len(body)} bytes without it")


def capture_time_ns(headers: dict[str, str], arrival_ns: int) -> int:
    """Return the time of capture [ns] that a part's headers tell, or its time of arrival when they tell none.

    Raises:
        SourceError: when X-Timestamp is there and no number of seconds.
    """
    text = headers.get(TIMESTAMP)
    if text is None:
        return arrival_ns
    try:
        stamp = int(Decimal(text) * NANOSECONDS)
    except (InvalidOperation, ValueError, OverflowError) as error:
        raise SourceError(f"expected seconds in X-Timestamp, found '{text}'") from error
    if not 0 <= stamp < 2**62:
        raise SourceError(f"expected seconds since the epoch in X-Timestamp, found '{text}'")
    return stamp


class MjpegStream:
    """Frames of one HTTP connection.

    Args:
        url: http:// or https://.
        timeout: [s] without a byte after which the stream counts as dead.
        now_ns: clock for parts without a stamp [ns].

    Raises:
        SourceError: when the connection or the content type is wrong.
    """

    def __init__(self, url: str, timeout: float, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._url, self._now_ns = url, now_ns
        try:
            # The scheme is checked by kind_of(): http and https only.
            self._response = urllib.request.urlopen(url, timeout=timeout)  # noqa: S310  scheme checked by kind_of()
        except (urllib.error.URLError, OSError, http.client.HTTPException, ValueError) as error:
            raise SourceError(
                f"{url}: expected a motion-JPEG stream, found: {error}; is the camera running?"
            ) from error
        headers: Message = self._response.headers
        try:
            self._parts = PartReader(self._response, boundary_of(headers.get("Content-Type", "")))
        except SourceError:
            self.close()
            raise

    def read(self) -> CameraFrame | None:
        """Return the next frame; None when the server ended the stream."""
        try:
            part = self._parts.next_part()
        except (OSError, http.client.HTTPException) as error:
            raise SourceError(f"{self._url}: the stream broke off: {error}") from error
        if part is None:
            return None
        headers, body = part
        try:
            width, height = jpeg_size(body)
        except FrameError as error:
            raise SourceError(f"{self._url}: {error}") from error
        return CameraFrame(capture_time_ns(headers, self._now_ns()), width, height, jpeg=body)

    def close(self) -> None:
        """Close the connection."""
        self._response.close()
