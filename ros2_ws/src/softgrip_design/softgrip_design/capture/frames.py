# SPDX-License-Identifier: Apache-2.0
"""Frames of a video file, of a row of images, or of a camera, with their times."""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError

Image = NDArray[np.uint8]
IMAGES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
#: Frame rate where a file does not know its own [Hz].
USUAL_RATE = 30.0
#: A decoder may lose a few frames at either end; more means that the file is damaged.
LOST_FRAMES, LOST_SHARE = 3, 0.02


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A picture.

    Attributes:
        time_s: [s] from the first one.
        image: (height, width, 3), BGR.
    """

    time_s: float
    image: Image


class Source(Protocol):
    """Where frames come from; may be read more than once."""

    @property
    def origin(self) -> str:
        """Name and digest, for the files made from it."""

    @property
    def count(self) -> int | None:
        """Number of frames, where it is known."""

    def frames(self) -> Iterator[VideoFrame]:
        """Read from the beginning.

        Raises:
            DesignError: a frame that cannot be read.
        """


@dataclass(frozen=True)
class Video:
    """A video file; times as in the file, or as given where the file was written without them."""

    path: Path
    times_s: tuple[float, ...] = ()

    @property
    def origin(self) -> str:
        """Name and digest."""
        with self.path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return f"{self.path.name} (sha256 {digest[:16]})"

    @property
    def count(self) -> int | None:
        """Number of frames by the file's own head."""
        reader = self._opened()
        count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT))
        reader.release()
        return count if count > 0 else None

    def frames(self) -> Iterator[VideoFrame]:
        """Read from the beginning.

        Raises:
            DesignError: no video, or one that breaks off.
        """
        promised = self.count
        reader = self._opened()
        rate = reader.get(cv2.CAP_PROP_FPS)
        rate = rate if math.isfinite(rate) and rate > 0.0 else USUAL_RATE
        read, last = 0, -math.inf
        try:
            while True:
                found, image = reader.read()
                if not found:
                    break
                last = self._time(read, last, 1e-3 * reader.get(cv2.CAP_PROP_POS_MSEC), 1.0 / rate)
                read += 1
                yield VideoFrame(last, image)
        finally:
            reader.release()
        if read == 0:
            raise DesignError(f"{self.path}: expected a video, found no frame that can be decoded; export it again")
        if promised is not None and promised - read > max(LOST_FRAMES, LOST_SHARE * promised):
            raise DesignError(
                f"{self.path}: expected {promised} frames as its head says, found {read} before it breaks off; the "
                "file is damaged, copy or record it again"
            )

    def _time(self, index: int, last: float, container_time: float, period: float) -> float:
        if index < len(self.times_s):
            return self.times_s[index]
        return container_time if container_time > last else last + period  # not every container keeps times

    def _opened(self) -> cv2.VideoCapture:
        if not self.path.is_file():
            raise DesignError(f"expected a video at {self.path}, found no such file")
        reader = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not reader.isOpened():
            raise DesignError(
                f"{self.path}: expected a video, found a file that cannot be opened as one; export it again"
            )
        return reader


@dataclass(frozen=True)
class Images:
    """A folder of images, in the order of the numbers in their names."""

    folder: Path
    rate: float
    paths: tuple[Path, ...] = field(init=False)

    def __post_init__(self) -> None:
        found = sorted((p for p in self.folder.iterdir() if p.suffix.lower() in IMAGES), key=_natural)
        if len(found) < 2:
            raise DesignError(f"{self.folder}: expected at least two images ({', '.join(IMAGES)}), found {len(found)}")
        object.__setattr__(self, "paths", tuple(found))

    @property
    def origin(self) -> str:
        """Name and number."""
        return f"{self.folder.name}, {len(self.paths)} images at {self.rate:g} Hz"

    @property
    def count(self) -> int | None:
        """Number of images."""
        return len(self.paths)

    def frames(self) -> Iterator[VideoFrame]:
        """Read from the beginning.

        Raises:
            DesignError: an image that cannot be read.
        """
        for index, path in enumerate(self.paths):
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image is None:
                raise DesignError(f"{path}: expected an image, found a file that cannot be read as one; take it out")
            yield VideoFrame(index / self.rate, np.asarray(image, dtype=np.uint8))


def record_camera(index: int, seconds: float, path: Path, advance: Callable[[float], None] = lambda _: None) -> Video:
    """Film for a while into a file, so that it can be read again; Ctrl-C ends it early.

    Args:
        index: of the camera.
        seconds: to film.
        path: of the file, Motion JPEG in AVI.
        advance: called with the seconds since the start.

    Raises:
        DesignError: no such camera, or one that gives no pictures.
    """
    reader = cv2.VideoCapture(index)
    writer, times = None, []
    try:
        if not reader.isOpened():
            raise DesignError(f"expected a camera at index {index}, found none; try another, or film into a file")
        began = time.monotonic()
        while (now := time.monotonic() - began) < seconds:
            found, image = reader.read()
            if not found:
                break
            if writer is None:
                size = image.shape[1], image.shape[0]
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), USUAL_RATE, size)
            writer.write(image)
            times.append(now)
            advance(now)
    except KeyboardInterrupt:
        pass  # the person has shown what there was to show
    finally:
        reader.release()
        if writer is not None:
            writer.release()
    if len(times) < 2:
        raise DesignError(f"expected pictures from camera {index}, found {len(times)}; is another program using it?")
    return Video(path, tuple(moment - times[0] for moment in times))


def _natural(path: Path) -> tuple[tuple[int, str], ...]:
    """Sort key that puts frame_2 before frame_10."""
    pieces = re.findall(r"\d+|\D+", path.name)
    return tuple((int(piece), "") if piece.isdigit() else (-1, piece) for piece in pieces)
