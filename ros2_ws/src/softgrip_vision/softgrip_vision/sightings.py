# SPDX-License-Identifier: Apache-2.0
"""From a spot in the image to a marker of the chain: candidate, sighting, seen."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import PlaneMap
from softgrip_vision.chain import mahalanobis2
from softgrip_vision.colour import Image
from softgrip_vision.looks import BodySide, Looks, surrounds_of
from softgrip_vision.spots import Spot

Array = NDArray[np.float64]


class Candidate(NamedTuple):
    """A spot with a marker's looks.

    Attributes:
        spot: in the image.
        point: (2,) [m] in the finger's plane.
        metric: (2, 2) [m^2/px^2] covariance of the point for a deviation of one pixel.
        surround: see looks.surrounds_of.
    """

    spot: Spot
    point: Array
    metric: Array
    surround: float


class Sighting(NamedTuple):
    """A candidate that may be a certain marker.

    Attributes:
        spot, point, surround: of the candidate.
        noise: (2, 2) [m^2] covariance of the point.
        distance: squared Mahalanobis distance from where the marker is expected.
    """

    spot: Spot
    point: Array
    surround: float
    noise: Array
    distance: float


class Seen(NamedTuple):
    """A marker that was seen in this frame."""

    spot: Spot
    point: Array
    confidence: float


def candidates_of(image: Image, spots: Sequence[Spot], plane: PlaneMap, side: BodySide) -> list[Candidate]:
    """Return spots with their places in a finger's plane and what surrounds them, all in one go."""
    if not spots:
        return []
    points, jacobians = plane.to_plane_with_jacobian(np.array([(spot.u, spot.v) for spot in spots]))
    metrics = jacobians @ jacobians.transpose(0, 2, 1)
    surrounds = surrounds_of(image, spots, side)
    return [Candidate(*parts) for parts in zip(spots, points, metrics, surrounds, strict=True)]


def locate(
    candidate: Candidate, looks: Looks, diameter_px: float, placement_stddev_m: float, expected: tuple[Array, Array]
) -> Sighting:
    """Return a candidate with its distance from a marker's expected place.

    Args:
        candidate: the spot.
        looks: of the marker.
        diameter_px: [px] of the marker.
        placement_stddev_m: [m] how exactly markers sit on the finger.
        expected: (2,) [m] where the marker is expected and (2, 2) [m^2] its covariance.
    """
    spot, point, metric, surround = candidate
    # What a covered edge can move the centre by is added to what noise can (see Looks.hidden_share).
    lopsided = looks.hidden_share(spot) * diameter_px / 2
    noise = metric * (spot.stddev_px**2 + lopsided**2)
    noise[0, 0] += placement_stddev_m**2
    noise[1, 1] += placement_stddev_m**2
    return Sighting(spot, point, surround, noise, mahalanobis2(point - expected[0], expected[1] + noise))


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
