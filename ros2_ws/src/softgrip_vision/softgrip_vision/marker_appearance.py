# SPDX-License-Identifier: Apache-2.0
"""What is remembered of how a marker looks, and how well a spot fits that."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softgrip_vision import _core
from softgrip_vision.colour import Image
from softgrip_vision.spots import Spot

#: Share of a new frame in what is remembered.
MEMORY = 0.2
#: The remembered area is that of a sharp, uncovered marker: what is larger is blurred, so it counts for little.
MEMORY_OF_LARGER, MEMORY_OF_SMALLER = 0.005, 0.5
#: It takes so many markers in sight to tell that all are smaller than remembered, not one of them covered.
MIN_FOR_AREA = 3
#: A spot with a smaller share of the remembered area is partly covered. Blur never shrinks a spot: its edge is taken
#: at a share of its own height.
MIN_AREA = 0.88
#: A spot this many times larger is something else, or merged with something.
MAX_AREA = 1.7
#: A spot's height may change by this factor from what is remembered (shadow, exposure).
HEIGHT_FACTOR = 3.0
#: ... and by this one when more than its place is asked for.
RETURN_HEIGHT_FACTOR = 1.6
#: Natural logarithm of how much the brightness around a marker, relative to its own, may differ when it comes back.
SURROUND_TOLERANCE = 0.4
#: Largest over smallest among the markers of one finger in one frame: area, height (some may be in shadow), surround.
ALIKE_AREA, ALIKE_HEIGHT, ALIKE_SURROUND = 1.2, 4.0, 2.3


class MarkerAppearance(NamedTuple):
    """What is remembered of one marker.

    Attributes:
        area_px: [px^2] when sharp and uncovered.
        height: [grey levels] of its signal.
        surround: brightness of the body around it over its own (surrounds_of): tells it from a green thing behind.
    """

    area_px: float
    height: float
    surround: float

    def admits(self, spot: Spot) -> bool:
        """Return whether a spot may be this marker, wholly in sight."""
        size_fits = MIN_AREA * self.area_px <= spot.area_px <= MAX_AREA * self.area_px
        return size_fits and self.height / HEIGHT_FACTOR <= spot.height <= HEIGHT_FACTOR * self.height

    def resembles(self, spot: Spot, surround: float) -> bool:
        """Return whether a spot also has the marker's surroundings: asked when the marker was out of sight."""
        same_light = 1.0 / RETURN_HEIGHT_FACTOR <= spot.height / self.height <= RETURN_HEIGHT_FACTOR
        same_body = abs(math.log(surround / self.surround)) < SURROUND_TOLERANCE
        return self.admits(spot) and same_light and same_body

    def hidden_share(self, spot: Spot) -> float:
        """Return 0..1 the share of the marker that a spot seems to lack."""
        return max(0.0, 1.0 - spot.area_px / self.area_px)

    def updated(self, spot: Spot, surround: float) -> MarkerAppearance:
        """Return the memory with one more sighting (its area aside: sharp_area)."""
        return MarkerAppearance(
            self.area_px,
            self.height + MEMORY * (spot.height - self.height),
            self.surround + MEMORY * (surround - self.surround),
        )

    def confidence(self, spot: Spot, distance: float, gate: float) -> float:
        """Return 0..1 how sure it is that a spot is this marker.

        The product of: size as remembered, contrast against the noise around, filled shape, and place as expected
        (``distance``: squared Mahalanobis distance, refused beyond ``gate``).
        """
        size = math.exp(-0.5 * (math.log(spot.area_px / self.area_px) / 0.25) ** 2)
        contrast = 1.0 - math.exp(-spot.height / (4.0 * spot.noise))
        return size * contrast * spot.solidity * math.exp(-0.5 * distance / gate)


def sharp_area(remembered_px: float, spots: Sequence[Spot]) -> float:
    """Return the area [px^2] of a finger's markers when sharp and uncovered, with one more frame's spots."""
    if len(spots) < MIN_FOR_AREA:
        return remembered_px
    change = statistics.median(spot.area_px for spot in spots) - remembered_px
    return remembered_px + (MEMORY_OF_LARGER if change > 0 else MEMORY_OF_SMALLER) * change


class BodySide(Enum):
    """Whether the finger's body is the brighter or the darker part of what lies around a marker."""

    DARKER = 0
    BRIGHTER = 1


def alike(image: Image, spots: Sequence[Spot]) -> BodySide | None:
    """Return the side on which spots, base to tip, all show the same body around them; None when they differ.

    They also have to be of one size and in similar light. A marker sits on an edge of the body more often than not, so
    it is the brighter, or the darker, part of its ring that tells. The base marker sits on the mount and may differ.
    """
    areas = [spot.area_px for spot in spots]
    heights = [spot.height for spot in spots]
    if max(areas) > ALIKE_AREA * min(areas) or max(heights) > ALIKE_HEIGHT * min(heights):
        return None
    spreads = {}
    for side in BodySide:
        around = surrounds_of(image, spots[1:], side)
        spreads[side] = max(around) / min(around)
    best = min(spreads, key=lambda side: spreads[side])
    return best if spreads[best] <= ALIKE_SURROUND else None


def surrounds_of(image: Image, spots: Sequence[Spot], side: BodySide) -> list[float]:
    """Return the brightness of the body's part of the ring around each spot over the spot's own (> 0)."""
    radii = [math.sqrt(spot.area_px / math.pi) for spot in spots]
    return _core.surrounds(image, _centres(spots), radii, side is BodySide.BRIGHTER)


def colours_at(image: Image, spots: Sequence[Spot]) -> NDArray[np.float64]:
    """Return the (k, 3) mean BGR colours of the 3x3 pixels at the spots' centres."""
    return _core.colours_at(image, _centres(spots))


def _centres(spots: Sequence[Spot]) -> NDArray[np.float64]:
    return np.array([spot[:2] for spot in spots]).reshape(-1, 2)
