# SPDX-License-Identifier: Apache-2.0
"""Round spots of a marker's colour: found, measured to a fraction of a pixel, with a standard deviation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from softgrip_vision import _core
from softgrip_vision.colour import ColourModel, Image


class Spot(NamedTuple):
    """One spot.

    Attributes:
        u, v: [px] centre, column and row.
        stddev_px: [px] one standard deviation of the centre along each axis.
        area_px: [px^2] area above half height, sub-pixel.
        roundness: 0..1 minor over major axis.
        solidity: 1 for a filled ellipse; less for a ring, a crescent or anything ragged.
        height: [grey levels] signal of its plateau above its surroundings.
        surroundings: [grey levels] signal around it.
        noise: [grey levels] standard deviation of the signal around it.
    """

    u: float
    v: float
    stddev_px: float
    area_px: float
    roundness: float
    solidity: float
    height: float
    surroundings: float
    noise: float


class Window(NamedTuple):
    """A part of an image: left, top, width, height [px], inside the image."""

    left: int
    top: int
    width: int
    height: int

    def cut(self, image: Image) -> Image:
        """Return the view of the image in this window."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def window_around(centre: tuple[float, float], half: float, image_size: tuple[int, int]) -> Window | None:
    """Return the square window around (u, v), clipped to the image (width, height); None when nothing is left."""
    (u, v), (width, height) = centre, image_size
    left, top = max(0, math.floor(u - half)), max(0, math.floor(v - half))
    right, bottom = min(width, math.ceil(u + half) + 1), min(height, math.ceil(v + half) + 1)
    if right - left < 3 or bottom - top < 3:
        return None
    return Window(left, top, right - left, bottom - top)


def find_spots(
    image: Image,
    windows: Sequence[Window],
    colour: ColourModel,
    thresholds: Sequence[float],
    area_range_px: tuple[float, float],
) -> list[list[Spot]]:
    """Return the spots in each window of an image, whole ones only (not cut by the window's border).

    Args:
        image: (h, w, 3) BGR.
        windows: (k,) where to look.
        colour: of the markers.
        thresholds: (k,) [grey levels] above which a pixel's signal counts.
        area_range_px: [px^2] smallest and largest area of interest.

    Raises:
        ValueError: when the image is none of 8-bit BGR, a window reaches out of it, or a number is none.
    """
    found = _core.find_spots(image, windows, colour.forms, thresholds, area_range_px)
    return [[Spot._make(values) for values in spots] for spots in found]
