# SPDX-License-Identifier: Apache-2.0
"""Choosing views of the board from any source: a folder of pictures, a video, a camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from softgrip_vision.calibrating.board import Board, BoardView
from softgrip_vision.errors import CalibrationError
from softgrip_vision.frame import FrameSource

#: A view is worth keeping when the board moved by this share of the image's width since every view kept.
MIN_MOVE = 0.04
MAX_VIEWS = 60


def collect_views(
    source: FrameSource,
    board: Board,
    *,
    max_frames: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[BoardView]:
    """Return views of the board that differ from each other.

    Args:
        source: of frames; read until it ends.
        board: looked for.
        max_frames: read at most so many frames (a camera never ends).
        progress: called with (frames read, views kept) after each frame.

    Raises:
        CalibrationError: when the frames change their size.
        SourceError, FrameError: as the source does.
    """
    kept: list[BoardView] = []
    for number in range(max_frames):
        frame = source.read()
        if frame is None or len(kept) >= MAX_VIEWS:
            break
        view = board.find(frame.pixels(), f"frame {number}")
        if view is not None:
            if kept and view.size != kept[0].size:
                raise CalibrationError(
                    f"{view.name}: expected all views of one resolution, {kept[0].size}, found {view.size}"
                )
            if is_new_view(view, kept):
                kept.append(view)
        if progress is not None:
            progress(number + 1, len(kept))
    return kept


def is_new_view(view: BoardView, kept: Sequence[BoardView]) -> bool:
    """Whether a view shows the board elsewhere than every view that was kept."""
    return all(_moved(view, other) for other in kept)


def _moved(view: BoardView, other: BoardView) -> bool:
    places = {tuple(np.round(point, 6)): pixel for point, pixel in zip(other.points, other.pixels, strict=True)}
    moves = [
        float(np.hypot(*(pixel - places[key])))
        for point, pixel in zip(view.points, view.pixels, strict=True)
        if (key := tuple(np.round(point, 6))) in places
    ]
    return not moves or float(np.mean(moves)) > MIN_MOVE * view.size[0]
