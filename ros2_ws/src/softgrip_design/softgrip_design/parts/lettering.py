# SPDX-License-Identifier: Apache-2.0
"""Letters as prisms, in the font that comes with matplotlib, so that every machine engraves the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Curve
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from softgrip_design.parts.forms import Outline, Point2, Prism, corners

Array = NDArray[np.float64]

_FONT = FontProperties(family="DejaVu Sans", weight="bold")
#: Points of a letter's outline closer than this, half a nozzle's width, become one.
MIN_STEP_MM = 0.2


@dataclass(frozen=True)
class Engraving:
    """Letters.

    Attributes:
        prisms: one for each closed shape.
        height_mm: of a capital.
        width_mm: of the whole text.
    """

    prisms: tuple[Prism, ...]
    height_mm: float
    width_mm: float


def engraving(text: str, place: Point2, room_mm: float, height_mm: float, depth_mm: tuple[float, float]) -> Engraving:
    """Return a text along x.

    Args:
        text: one line.
        place: (x, y) of the start of its base line.
        room_mm: longest it may be; a longer text is made smaller.
        height_mm: of its capitals.
        depth_mm: z from where to where.
    """
    loops = [np.array(loop)[:-1] for loop in TextPath((0.0, 0.0), text, size=100.0, prop=_FONT).to_polygons()]
    capital = float(TextPath((0.0, 0.0), "H", size=100.0, prop=_FONT).get_extents().height)
    everything = np.vstack(loops)
    left, right = float(everything[:, 0].min()), float(everything[:, 0].max())
    scale = min(height_mm / capital, room_mm / (right - left))
    placed = [_thinned((loop - (left, 0.0)) * scale + place) for loop in loops]
    prisms = tuple(
        Prism(outer, *depth_mm, holes=holes) for outer, holes in _shapes([loop for loop in placed if len(loop) > 2])
    )
    return Engraving(prisms, scale * capital, scale * (right - left))


def _thinned(loop: Array) -> Array:
    kept = [loop[0]]
    for point in loop[1:]:
        if np.hypot(*(point - kept[-1])) >= MIN_STEP_MM:
            kept.append(point)
    if np.hypot(*(kept[0] - kept[-1])) < MIN_STEP_MM:
        kept.pop()
    return np.array(kept)


def _shapes(loops: list[Array]) -> list[tuple[Outline, tuple[Outline, ...]]]:
    """Return each outer loop with its holes; TrueType runs outer loops clockwise, holes the other way."""
    outer = [loop for loop in loops if _signed_area(loop) < 0.0]
    holes = [loop for loop in loops if _signed_area(loop) > 0.0]
    return [
        (corners(*loop[::-1]), tuple(corners(*hole) for hole in holes if Curve(loop).contains_point(hole[0])))
        for loop in outer
    ]


def _signed_area(loop: Array) -> float:
    x, y = loop.T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
