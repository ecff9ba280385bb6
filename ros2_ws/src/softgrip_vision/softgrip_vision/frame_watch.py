# SPDX-License-Identifier: Apache-2.0
"""Tells a camera that delivers but does not see: frozen, dark, over-exposed, or losing frames."""

from __future__ import annotations

import statistics
from collections import deque

import numpy as np

from softgrip_time.units import to_ns, to_s
from softgrip_vision.frame import CameraFrame

#: [s] of the same picture, bit for bit: a sensor's noise never repeats
FROZEN_TIME = 0.5
#: grey level 0..255 that hardly any pixel of a dark picture reaches; share of the pixels that do
DARK_LEVEL, DARK_SHARE = 60, 0.02
#: grey level from which a pixel is blown out, and the share of them from which the picture is
BRIGHT_LEVEL, BRIGHT_SHARE = 250, 0.1
#: [s] over which frames are counted; share of missing ones worth a word
COUNT_TIME, MISSING_SHARE = 2.0, 0.25
#: pixels looked at in each direction
LOOK = 80


class FirstFrameWatch:
    """Tells a camera that is starting from one that never delivers.

    Args:
        limit_s: the first frame may take so long [s] from the first question on.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._since_s: float | None = None

    def problem(self, now_s: float) -> str:
        """Return what is wrong in words while no frame has come, empty while it is early.

        Args:
            now_s: steady clock [s].
        """
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._since_s < self._limit_s:
            return ""
        return f"expected a first frame within {self._limit_s:g} s, found none; check camera, cable and source"


class FrameWatch:
    """Sees every frame, and is asked now and then what is wrong."""

    def __init__(self) -> None:
        self._last: CameraFrame | None = None
        self._same_since = 0
        self._stamps: deque[int] = deque()

    def observe_frame(self, frame: CameraFrame) -> None:
        """Record a frame."""
        if self._last is None or not _same(frame, self._last):
            self._same_since = frame.stamp_ns
        self._last = frame
        self._stamps.append(frame.stamp_ns)
        while frame.stamp_ns - self._stamps[0] > to_ns(COUNT_TIME):
            self._stamps.popleft()

    def problem(self) -> str:
        """Return what is wrong in words, empty when nothing is.

        Raises:
            FrameError: the newest frame cannot be decoded.
        """
        frame = self._last
        if frame is None:
            return ""
        frozen = to_s(frame.stamp_ns - self._same_since)
        if frozen > FROZEN_TIME:
            return f"the picture is frozen: the same for {frozen:.1f} s, bit for bit; restart the camera"
        pixels = frame.pixels()
        step = (max(1, pixels.shape[0] // LOOK), max(1, pixels.shape[1] // LOOK))
        grey = pixels[:: step[0], :: step[1]].max(axis=2)
        lit = float(np.mean(grey > DARK_LEVEL))
        if lit < DARK_SHARE:
            return f"too dark: {lit:.0%} of the pixels above {DARK_LEVEL} of 255; check light, lens cap and exposure"
        blown = float(np.mean(grey >= BRIGHT_LEVEL))
        if blown > BRIGHT_SHARE:
            return f"over-exposed: {blown:.0%} of the pixels at the end of their range; reduce light or exposure"
        missing = self._missing()
        if missing > MISSING_SHARE:
            return f"frames are lost: {missing:.0%} of the last {COUNT_TIME:.0f} s; check cable, USB and processor load"
        return ""

    def _missing(self) -> float:
        """Share of frames that the usual interval between two leaves a gap for."""
        if len(self._stamps) < 10:
            return 0.0
        stamps = np.array(self._stamps, dtype=np.int64)
        intervals = np.diff(stamps).astype(float)
        usual = float(statistics.median_low(sorted(intervals)[: max(1, len(intervals) // 2)]))
        gaps = np.maximum(np.round(intervals / usual) - 1.0, 0.0) if usual > 0.0 else np.zeros(1)
        return float(gaps.sum() / (gaps.sum() + len(intervals)))


def _same(frame: CameraFrame, other: CameraFrame) -> bool:
    """Whether two frames agree bit for bit."""
    if frame.jpeg is not None or other.jpeg is not None:
        return frame.jpeg == other.jpeg
    return np.array_equal(frame.pixels(), other.pixels())
