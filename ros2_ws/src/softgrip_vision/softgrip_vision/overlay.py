# SPDX-License-Identifier: Apache-2.0
"""A frame with what was found in it drawn in."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from softgrip_vision.colour import Image
from softgrip_vision.readings import FingerReading

SEEN = (255, 90, 30)
HIDDEN = (40, 120, 255)
TEXT = (255, 255, 255)
#: Fixed-point bits of OpenCV's drawing coordinates.
SHIFT = 4


def draw(image: Image, readings: Sequence[FingerReading]) -> Image:
    """Return a copy of an (h, w, 3) BGR frame with markers, links, angles and problems drawn in.

    Seen markers are filled crosses with their name, hidden ones open circles as large as three standard deviations.
    """
    canvas = image.copy()
    for row, reading in enumerate(readings):
        known = [marker for marker in reading.markers if math.isfinite(float(marker.pixel.sum()))]
        corners = np.array([marker.pixel for marker in known]).reshape(-1, 2)
        cv2.polylines(canvas, [_fixed(corners)], False, SEEN, 1, cv2.LINE_AA, SHIFT)
        for marker in known:
            at = _fixed(marker.pixel[None, :])[0]
            if marker.occluded:
                radius = int(max(4.0, min(200.0, 3.0 * marker.stddev_px)) * 2**SHIFT)
                cv2.circle(canvas, tuple(at.tolist()), radius, HIDDEN, 1, cv2.LINE_AA, SHIFT)
            else:
                cv2.circle(canvas, tuple(at.tolist()), 2 * 2**SHIFT, SEEN, -1, cv2.LINE_AA, SHIFT)
            place = (round(float(marker.pixel[0])) + 8, round(float(marker.pixel[1])) - 8)
            cv2.putText(canvas, marker.name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, TEXT, 1, cv2.LINE_AA)
        cv2.putText(
            canvas, _caption(reading), (12, 24 + 22 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.55, TEXT, 1, cv2.LINE_AA
        )
    return np.asarray(canvas, dtype=np.uint8)


def _caption(reading: FingerReading) -> str:
    if reading.pose is None:
        return f"{reading.finger}: {reading.problem}"
    angles = "  ".join(f"{math.degrees(angle):6.1f}" for angle in reading.pose.angles)
    return f"{reading.finger} [{reading.profile}]  {angles} deg"


def _fixed(
    points: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    return np.asarray(np.rint(points * 2**SHIFT), dtype=np.int32)
