# SPDX-License-Identifier: Apache-2.0
"""Frames when they are due, stamped in the cell's time: of a camera as they come, of a film by that time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Final

import cv2
import numpy as np

from softgrip_design.capture.frames import Source, VideoFrame
from softgrip_design.errors import DesignError

#: A camera that gives no frame for so long is gone [s].
CAMERA_TIMEOUT_S: Final = 2.0
#: A film's frame that is so much behind the cell's time is left out, as a camera's would be [s].
MAX_DELAY_S: Final = 0.05
_POLL_S: Final = 0.002


def camera_frames(index: int, cell_time_s: Callable[[], float]) -> Iterator[VideoFrame]:
    """Yield the frames of a camera, none kept waiting where the driver of the camera allows it.

    Args:
        index: of the camera.
        cell_time_s: the cell's time [s].

    Raises:
        DesignError: no such camera, or one that falls silent.
    """
    reader = cv2.VideoCapture(index)
    try:
        if not reader.isOpened():
            raise DesignError(f"expected a camera at index {index}, found none; try another, or give a film")
        reader.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        last_s = time.monotonic()
        while True:
            found, image = reader.read()
            if found:
                last_s = time.monotonic()
                yield VideoFrame(cell_time_s(), np.asarray(image, dtype=np.uint8))
            elif time.monotonic() - last_s > CAMERA_TIMEOUT_S:
                raise DesignError(f"expected pictures of camera {index}, found none for {CAMERA_TIMEOUT_S:g} s")
    finally:
        reader.release()


def film_frames(film: Source, cell_time_s: Callable[[], float], is_ended: Callable[[], bool]) -> Iterator[VideoFrame]:
    """Yield the frames of a film when the cell's time has come for them; those that are late are left out.

    Args:
        film: to be shown once.
        cell_time_s: the cell's time [s].
        is_ended: asked while waiting.

    Raises:
        DesignError: a film that cannot be read.
    """
    begun_s = cell_time_s()
    with closing(film.frames()) as frames:  # type: ignore[type-var]
        for frame in frames:
            while cell_time_s() - begun_s < frame.time_s:
                if is_ended():
                    return
                time.sleep(_POLL_S)
            if cell_time_s() - begun_s - frame.time_s <= MAX_DELAY_S:
                yield VideoFrame(begun_s + frame.time_s, frame.image)
