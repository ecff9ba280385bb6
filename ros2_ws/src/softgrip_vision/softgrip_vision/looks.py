# SPDX-License-Identifier: Apache-2.0
"""What is remembered of how a marker looks, and how well a spot fits that."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.colour import Image
from softgrip_vision.spots import Spot

#: Share of a new frame in what is remembered.
MEMORY = 0.2
#: The remembered area is that of a sharp, uncovered marker: what is larger is blurred, so it counts for little.
MEMORY_OF_LARGER, MEMORY_OF_SMALLER = 0.005, 0.5
#: It takes so many markers in sight to tell that all are smaller than remembered, not one of them covered.
FEWEST_FOR_AREA = 3
#: A spot with a smaller share of the remembered area is partly covered. Blur never shrinks a spot: its edge is taken
#: at a share of its own height.
LEAST_AREA = 0.88
#: A spot this many times larger is something else, or merged with something.
MOST_AREA = 1.7
#: A spot's height may change by this factor from what is remembered (shadow, exposure).
HEIGHT_FACTOR = 3.0
#: ... and by this one when more than its place is asked for.
RETURN_HEIGHT_FACTOR = 1.6
#: Natural logarithm of how much the brightness around a marker, relative to its own, may differ when it comes back.
SURROUND_TOLERANCE = 0.4
#: Largest over smallest among the markers of one finger in one frame: area, height (some may be in shadow), surround.
ALIKE_AREA, ALIKE_HEIGHT, ALIKE_SURROUND = 1.2, 4.0, 2.3
#: Radius of the ring around a marker that shows the finger, in marker radii, and its samples.
RING_RADIUS = 1.4
RING_SAMPLES = 16
#: As many of them at least show the finger's body.
BODY_SAMPLES = 3
#: The 3x3 pixels at a spot's centre show its colour.
_CENTRE = np.array([(column, row) for row in (-1, 0, 1) for column in (-1, 0, 1)])
_RING = RING_RADIUS * np.array(
    [(math.cos(turn), math.sin(turn)) for turn in np.arange(RING_SAMPLES) * 2 * math.pi / RING_SAMPLES]
)


@dataclass(frozen=True)
class Looks:
    """What is remembered of one marker.

    Attributes:
        area_px: [px^2] when sharp and uncovered.
        height: [grey levels] of its signal.
        surround: brightness of the body around it over its own (surround_of): tells it from a green thing behind.
    """

    area_px: float
    height: float
    surround: float

    def admits(self, spot: Spot) -> bool:
        """Return whether a spot may be this marker, wholly in sight."""
        size_fits = LEAST_AREA * self.area_px <= spot.area_px <= MOST_AREA * self.area_px
        return size_fits and self.height / HEIGHT_FACTOR <= spot.height <= HEIGHT_FACTOR * self.height

    def resembles(self, spot: Spot, surround: float) -> bool:
        """Return whether a spot also has the marker's surroundings: asked when the marker was out of sight."""
        same_light = 1.0 / RETURN_HEIGHT_FACTOR <= spot.height / self.height <= RETURN_HEIGHT_FACTOR
        same_body = abs(math.log(surround / self.surround)) < SURROUND_TOLERANCE
        return self.admits(spot) and same_light and same_body

    def hidden_share(self, spot: Spot) -> float:
        """Return 0..1 the share of the marker that a spot seems to lack."""
        return max(0.0, 1.0 - spot.area_px / self.area_px)

    def updated(self, spot: Spot, surround: float) -> Looks:
        """Return the memory with one more sighting (its area aside: sharp_area)."""
        return Looks(
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
    if len(spots) < FEWEST_FOR_AREA:
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
    centres = np.array([(spot.u, spot.v) for spot in spots])
    radii = np.sqrt(np.array([spot.area_px for spot in spots]) / math.pi)
    rings = np.floor(_RING * radii[:, None, None] + (centres + 0.5)[:, None, :])
    samples = np.concatenate([rings, _CENTRE + np.rint(centres)[:, None, :]], axis=1)
    brightness = _pixels(image, samples).sum(axis=2)
    ring = np.sort(brightness[:, :RING_SAMPLES], axis=1)
    around = ring[:, -BODY_SAMPLES if side is BodySide.BRIGHTER else BODY_SAMPLES - 1]
    own = brightness[:, RING_SAMPLES:].sum(axis=1) / len(_CENTRE)
    return [float(ratio) for ratio in (around + 1.0) / (own + 1.0)]


def colours_at(image: Image, spots: Sequence[Spot]) -> NDArray[np.float64]:
    """Return the (k, 3) mean BGR colours of the 3x3 pixels at the spots' centres."""
    centres = np.rint([(spot.u, spot.v) for spot in spots])
    return np.asarray(_pixels(image, _CENTRE + centres[:, None, :]).mean(axis=1), dtype=np.float64)


def _pixels(image: Image, samples: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the (k, m, 3) colours at (k, m, 2) places [px]; outside of the image those of its border."""
    columns = np.minimum(np.maximum(samples[:, :, 0], 0), image.shape[1] - 1).astype(np.intp)
    rows = np.minimum(np.maximum(samples[:, :, 1], 0), image.shape[0] - 1).astype(np.intp)
    return np.asarray(image[rows, columns], dtype=np.int64)
