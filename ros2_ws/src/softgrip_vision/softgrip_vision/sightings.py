# SPDX-License-Identifier: Apache-2.0
"""From a spot in the image to a marker of the chain: candidate, sighting, seen."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softgrip_vision.calibration import PlaneMap
from softgrip_vision.chain import Place, Spread
from softgrip_vision.colour import Image
from softgrip_vision.marker_appearance import BodySide, MarkerAppearance, surrounds_of
from softgrip_vision.spots import Spot


class Candidate(NamedTuple):
    """A spot with a marker's looks.

    Attributes:
        spot: in the image.
        point: [m] in the finger's plane.
        metric: [m^2/px^2] covariance of the point for a deviation of one pixel.
        surround: see marker_appearance.surrounds_of.
    """

    spot: Spot
    point: Place
    metric: Spread
    surround: float


class Sighting(NamedTuple):
    """A candidate that may be a certain marker.

    Attributes:
        spot, point, surround: of the candidate.
        noise: [m^2] covariance of the point.
        distance: squared Mahalanobis distance from where the marker is expected.
    """

    spot: Spot
    point: Place
    surround: float
    noise: Spread
    distance: float


class Seen(NamedTuple):
    """A marker that was seen in this frame."""

    spot: Spot
    point: Place
    confidence: float


def candidates_of(image: Image, spots: Sequence[Spot], plane: PlaneMap, side: BodySide) -> list[Candidate]:
    """Return spots with their places in a finger's plane and what surrounds them, all in one go."""
    if not spots:
        return []
    points, jacobians = plane.to_plane_with_jacobian(np.array([spot[:2] for spot in spots]))
    metrics = (jacobians @ jacobians.transpose(0, 2, 1)).reshape(-1, 4)[:, (0, 1, 3)].tolist()
    surrounds = surrounds_of(image, spots, side)
    return [
        Candidate(spot, (x, y), Spread(*metric), surround)
        for spot, (x, y), metric, surround in zip(spots, points.tolist(), metrics, surrounds, strict=True)
    ]


def locate(
    candidate: Candidate,
    appearance: MarkerAppearance,
    diameter_px: float,
    placement_stddev_m: float,
    expected: tuple[Place, Spread],
) -> Sighting:
    """Return a candidate with its distance from a marker's expected place.

    Args:
        candidate: the spot.
        appearance: of the marker.
        diameter_px: [px] of the marker.
        placement_stddev_m: [m] how exactly markers sit on the finger.
        expected: [m] where the marker is expected and [m^2] its covariance.
    """
    spot, (x, y), metric, surround = candidate
    (expected_x, expected_y), spread = expected
    # What a covered edge can move the centre by is added to what noise can (see MarkerAppearance.hidden_share).
    lopsided = appearance.hidden_share(spot) * diameter_px / 2
    variance, placement = spot.stddev_px**2 + lopsided**2, placement_stddev_m**2
    noise = Spread(metric.xx * variance + placement, metric.xy * variance, metric.yy * variance + placement)
    both = Spread(spread.xx + noise.xx, spread.xy + noise.xy, spread.yy + noise.yy)
    return Sighting(spot, candidate.point, surround, noise, both.distance2(x - expected_x, y - expected_y))


def threshold_quality(spots: Sequence[Spot]) -> float:
    """Return 0..1 how well markers stand out: the between-class share of the signal's variance, h^2 / (h^2 + (2 s)^2).

    h is the markers' median height over their surroundings and s the surroundings' noise; 0.5 means that markers are
    two deviations high, and 0 that none was seen.
    """
    if not spots:
        return 0.0
    height = statistics.median(spot.height for spot in spots)
    noise = statistics.median(spot.noise for spot in spots)
    return height**2 / (height**2 + (2.0 * noise) ** 2)
