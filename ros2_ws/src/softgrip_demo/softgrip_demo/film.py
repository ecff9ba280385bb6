# SPDX-License-Identifier: Apache-2.0
"""The film of a grasp: camera frames with the predicted free motion projected into them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softgrip_demo.alignment import Instant, at_stamp
from softgrip_demo.record import ShiftFrame

if TYPE_CHECKING:
    from softgrip_vision.calibration import PlaneMap

LONGEST_FILM = 90  # frames; more would make the page heavy


def chain(link_lengths: Sequence[float], angles: Sequence[float]) -> np.ndarray:
    """Return the points of a finger from its first joint to the tip, shape (n + 1, 2) [m], closing towards -y."""
    headings = -np.cumsum(angles)
    steps = np.array(link_lengths)[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])


def make(
    frames: Sequence[tuple[float, bytes]],
    instants: Sequence[Instant],
    link_lengths: Sequence[float],
    plane: PlaneMap,
    folder: Path,
) -> tuple[ShiftFrame, ...]:
    """Write the frames as JPEG files into ``folder/film`` and return the film, without frames that have no prediction.

    Args:
        frames: (stamp [s], JPEG bytes), oldest first.
        instants: predictions, any order.
        link_lengths: [m], base to tip.
        plane: where the finger's plane lies in the image.
        folder: of the shift's record.
    """
    ordered = sorted(instants, key=lambda instant: instant.stamp)
    matched = [(stamp, jpeg, found) for stamp, jpeg in frames if (found := at_stamp(ordered, stamp)) is not None]
    every = max(1, -(-len(matched) // LONGEST_FILM))
    film_folder = folder / "film"
    film_folder.mkdir(parents=True, exist_ok=True)
    film = []
    for number, (stamp, jpeg, instant) in enumerate(matched[::every]):
        name = f"film/{number:03d}.jpg"
        (folder / name).write_bytes(jpeg)
        pixels = plane.to_pixels(chain(link_lengths, instant.angles))
        film.append(
            ShiftFrame(
                image=name,
                time=stamp - matched[0][0],
                predicted_joints=tuple((round(float(u), 1), round(float(v), 1)) for u, v in pixels),
                tension=instant.tension,
                predicted_tension=instant.predicted_tension,
            )
        )
    return tuple(film)
