# SPDX-License-Identifier: Apache-2.0
"""The recording with what was seen drawn into it: bones, joint angles, the motion it belongs to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_design.capture.frames import Image, Source
from softgrip_design.capture.grasps import DetectedGrasp, Kind
from softgrip_design.capture.recording import RecordedMotion, Recording
from softgrip_design.errors import DesignError
from softgrip_design.landmarks import CHAINS

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

#: BGR; by finger, base to tip of the hand.
COLOURS: dict[str, Colour] = {
    "thumb": (60, 180, 255),
    "index": (80, 200, 80),
    "middle": (220, 160, 60),
    "ring": (200, 90, 200),
    "little": (90, 90, 240),
}
BANNER: dict[Kind, Colour] = {
    Kind.POWER: (60, 60, 200),
    Kind.PINCH: (60, 150, 60),
    Kind.HOOK: (180, 100, 40),
    Kind.NONE: (110, 110, 110),
}
WIDEST_PX = 960
FONT = cv2.FONT_HERSHEY_SIMPLEX


def write_overlay(
    source: Source,
    recording: Recording,
    motion: RecordedMotion,
    grasps: Sequence[DetectedGrasp],
    path: Path,
    advance: Callable[[int], None] = lambda _: None,
) -> None:
    """Write the frames again with landmarks, angles and motions, as MP4.

    Args:
        source: of the frames, read a second time.
        recording: their landmarks.
        motion: their angles.
        grasps: what was found in it.
        path: of the video.
        advance: called with the number of frames done.

    Raises:
        DesignError: the video cannot be written.
    """
    rate = 1.0 / float(np.median(np.diff(recording.times)))
    writer, size = None, (0, 0)
    try:
        for index, frame in enumerate(source.frames()):
            if writer is None:
                size, writer = _writer(frame.image, rate, path)
            image = np.asarray(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            _draw_hand(image, recording.pixel[index] * size[0] / frame.image.shape[1])
            _draw_angles(image, motion, frame.time_s)
            _draw_grasp(image, grasps, frame.time_s)
            writer.write(image)
            advance(index + 1)
    finally:
        if writer is not None:
            writer.release()


def _writer(image: Image, rate: float, path: Path) -> tuple[tuple[int, int], cv2.VideoWriter]:
    height, width = image.shape[:2]
    scale = min(1.0, WIDEST_PX / width)
    size = (int(width * scale) // 2 * 2, int(height * scale) // 2 * 2)  # the encoder wants even sides
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, size)
    if not writer.isOpened():
        raise DesignError(f"{path}: expected to write an MP4 video, found that it cannot be opened; use --no-overlay")
    return size, writer


def _draw_hand(image: Image, pixel: Array) -> None:
    if not np.isfinite(pixel).all():
        _text(image, "no hand", (10, image.shape[0] - 12), (60, 60, 255))
        return
    points = np.rint(pixel).astype(int)
    for finger, chain in CHAINS.items():
        path = points[list(chain if chain[0] == 0 else (0, *chain))]
        cv2.polylines(image, [path.reshape(-1, 1, 2)], isClosed=False, color=COLOURS[finger], thickness=2)
        for x, y in path[1:]:
            cv2.circle(image, (int(x), int(y)), 4, COLOURS[finger], -1)


def _draw_angles(image: Image, motion: RecordedMotion, time_s: float) -> None:
    sample = int(np.abs(motion.times - time_s).argmin())
    for row, (finger, angles) in enumerate(motion.angles.items()):
        values = np.degrees(angles[sample])
        text = "  ".join(f"{value:3.0f}" for value in values) if np.isfinite(values).all() else "-"
        _text(image, f"{finger:7s}{text}", (10, 52 + 20 * row), COLOURS[finger])


def _draw_grasp(image: Image, grasps: Sequence[DetectedGrasp], time_s: float) -> None:
    for grasp in grasps:
        if grasp.start_s <= time_s <= grasp.end_s:
            cv2.rectangle(image, (0, 0), (image.shape[1], 30), BANNER[grasp.kind], -1)
            _text(image, f"{grasp.kind}: {grasp.why}", (10, 20), (255, 255, 255), edge=False)


def _text(image: Image, text: str, at: tuple[int, int], colour: Colour, *, edge: bool = True) -> None:
    if edge:
        cv2.putText(image, text, at, FONT, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(image, text, at, FONT, 0.5, colour, 1, cv2.LINE_AA)
