# SPDX-License-Identifier: Apache-2.0
"""One finger's markers, followed from frame to frame, from the moment that a search has found its chain.

Per frame: predict the chain; look at once in small windows around every marker's predicted place, where nearly all are.
Then, base to tip, the chain says where a marker has to be, refined by every marker already found; accept the spot that
fits place, size and colour; if none does, look wherever the marker can be. A marker that was out of sight has to prove
itself (:meth:`FollowedChain._returns`).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softgrip_vision.calibration import PlaneMap
from softgrip_vision.chain import ChainFilter, ChainGeometry, Place, Spread
from softgrip_vision.colour import ColourModel, Image, hue_of
from softgrip_vision.layout import JOINT_RANGE
from softgrip_vision.marker_appearance import (
    MAX_AREA,
    BodySide,
    MarkerAppearance,
    colours_at,
    sharp_area,
    surrounds_of,
)
from softgrip_vision.options import TrackerOptions
from softgrip_vision.search import FoundChain
from softgrip_vision.sightings import Candidate, Seen, Sighting, candidates_of, locate
from softgrip_vision.spots import Spot, find_spots, window_around

#: Squared Mahalanobis distance within which a spot may be the marker (chi-square, 2 degrees of freedom: 99.97 %).
GATE = 16.0
#: Squared Mahalanobis distance up to which a spot need not have the marker's surroundings as well, and one near the
#: predicted place is not compared with what lies farther away.
UNSURPRISING = 4.0
#: Windows reach this many deviations of the predicted place, and are at most this large [px].
WINDOW_SIGMAS = 4.0
LARGEST_WINDOW_HALF_PX = 160.0
#: [marker diameters] The windows looked at first reach this far around the predicted places.
NEAR_REACH = 0.5
#: Hues this far from the finger's own, once known, give no signal [deg].
KNOWN_HUE_HALF_ANGLE = 40.0
#: A place known to better than this share of a marker's diameter leaves no room for another marker.
SURE_SHARE = 0.3
#: When the marker before it on the chain is hidden, a marker is taken only at a place known to this many of its
#: diameters: when it was in sight just now, and when it comes back.
STAYING_SHARE, RETURNING_SHARE = 1.5, 0.8
#: [m] and relative: how far the distance to the marker before may be off the link's length.
LINK_TOLERANCE = (0.5e-3, 0.02)
#: A link looks at most so much longer than where the first joint is: perspective, and the tolerance above.
LINK_SLACK = 1.25
#: [rad/s] faster than this no joint moves; between two sightings of a marker that comes back.
FASTEST_JOINT = 12.0


@dataclass(frozen=True)
class FollowedFinger:
    """A finger as its camera sees it.

    Attributes:
        geometry: of its chain.
        plane: between pixels and the finger's plane.
        diameter_px: [px] of its markers.
        pixels_per_metre: where the first joint is.
    """

    geometry: ChainGeometry
    plane: PlaneMap
    diameter_px: float
    pixels_per_metre: float


class FollowedFrame(NamedTuple):
    """A frame, for one finger.

    Attributes:
        image: (h, w, 3) BGR.
        stamp: [s] of capture.
        rivals: [px] where the markers of other fingers are expected.
        options: what a user may set.
    """

    image: Image
    stamp: float
    rivals: Sequence[Place]
    options: TrackerOptions


class FollowedChain:
    """The chain of one finger, from the search that found it to the moment when it is lost.

    Args:
        view: of the finger.
        image: (h, w, 3) BGR, in which the chain was found.
        found: by the search.
        side: on which the finger's body lies beside its markers.
    """

    def __init__(self, view: FollowedFinger, image: Image, found: FoundChain, side: BodySide) -> None:
        self._view = view
        self._side = side
        self._colour = ColourModel(hue_of(np.median(colours_at(image, found.spots), axis=0)), KNOWN_HUE_HALF_ANGLE)
        # All markers of a finger have one size; the middle one of five is better known than each.
        area = statistics.median(spot.area_px for spot in found.spots)
        surrounds = surrounds_of(image, found.spots, side)
        self._appearances = [
            MarkerAppearance(area, spot.height, around) for spot, around in zip(found.spots, surrounds, strict=True)
        ]
        self._in_sight = [True] * len(found.spots)
        self._returning: dict[int, tuple[float, Place]] = {}
        self._predicted: list[Place] = [(spot.u, spot.v) for spot in found.spots]
        #: Angles, tip and where hidden markers are.
        self.filter = ChainFilter(view.geometry)
        self.filter.place(found.points)

    def predict(self, seconds: float) -> Sequence[Place]:
        """Advance by a time [s] > 0; return the (n + 2,) places [px] where the markers are expected."""
        self.filter.predict(seconds)
        places = self._view.plane.to_pixels(self._view.geometry.markers(self.filter.state))
        self._predicted = [(u, v) for u, v in places.tolist()]
        return self._predicted

    def follow(self, frame: FollowedFrame) -> list[Seen | None]:
        """Find every marker in a frame, base to tip, and take each into the filter; None for each that is hidden."""
        markers = range(len(self._predicted))
        near = self._look(frame, markers, self._predicted, NEAR_REACH * self._view.diameter_px)
        seen: list[Seen | None] = []
        for marker in markers:
            seen.append(self._follow_marker(frame, marker, near[marker], seen))
        self._in_sight = [found is not None for found in seen]
        area = sharp_area(self._appearances[0].area_px, [found.spot for found in seen if found is not None])
        self._appearances = [appearance._replace(area_px=area) for appearance in self._appearances]
        return seen

    def _follow_marker(
        self, frame: FollowedFrame, marker: int, near: Sequence[Candidate], seen: list[Seen | None]
    ) -> Seen | None:
        """Find one marker where the chain, with all markers before it taken in, expects it; take it in.

        Args:
            frame: to look in.
            marker: its number.
            near: what looks like it around its predicted place.
            seen: the markers before it, None for each that is hidden.
        """
        expected = self.filter.expect(marker)
        stddev_px = math.sqrt(expected[1].largest) * self._view.pixels_per_metre
        parent = seen[-1] if seen else None
        best = self._best(frame, marker, near, expected, seen)
        if best is None or best.distance > UNSURPRISING:
            place, clear = self._where_it_can_be(marker, expected[0], stddev_px, parent)
            (anywhere,) = self._look(frame, [marker], [place], clear)
            best = self._best(frame, marker, anywhere, expected, seen)
        if best is None:
            self._returning.pop(marker, None)
            return None
        appearance = self._appearances[marker]
        if best.distance > UNSURPRISING and not appearance.resembles(best.spot, best.surround):
            return None
        if parent is None and marker > 0:
            # Nothing near holds it: only a place that is well known will do.
            trusted = STAYING_SHARE if self._in_sight[marker] else RETURNING_SHARE
            if stddev_px > trusted * self._view.diameter_px or not appearance.resembles(best.spot, best.surround):
                return None
        if not self._in_sight[marker] and not self._returns(marker, best, stddev_px, frame.stamp):
            return None
        self.filter.update(marker, best.point, best.noise)
        self._appearances[marker] = appearance.updated(best.spot, best.surround)
        return Seen(best.spot, best.point, appearance.confidence(best.spot, best.distance, GATE))

    def _look(
        self, frame: FollowedFrame, markers: Sequence[int], places: Sequence[Place], clear: float
    ) -> list[list[Candidate]]:
        """Return, for each of some markers, what looks like it around its place.

        Args:
            frame: to look in.
            markers: (k,) their numbers.
            places: (k,) [px] of each.
            clear: [px] spots whose centre is within this of the place are seen whole.
        """
        image = frame.image
        half = min(LARGEST_WINDOW_HALF_PX, clear + 0.9 * self._view.diameter_px + 3.0)
        size = image.shape[1], image.shape[0]
        windows = {
            marker: window
            for marker, place in zip(markers, places, strict=True)
            if (window := window_around(place, half, size)) is not None
        }
        if not windows:
            return [[] for _ in markers]
        thresholds = [frame.options.threshold_share * self._appearances[marker].height for marker in windows]
        area = self._appearances[0].area_px
        spots = find_spots(image, list(windows.values()), self._colour, thresholds, (0.5 * area, MAX_AREA * area))
        admitted = {
            marker: [spot for spot in found if self._appearances[marker].admits(spot)]
            for marker, found in zip(windows, spots, strict=True)
        }
        all_spots = [spot for found in admitted.values() for spot in found]
        candidates = iter(candidates_of(image, all_spots, self._view.plane, self._side))
        return [[next(candidates) for _ in admitted.get(marker, ())] for marker in markers]

    def _where_it_can_be(
        self, marker: int, expected: Place, stddev_px: float, parent: Seen | None
    ) -> tuple[Place, float]:
        """Return the place [px] around which a marker is looked for and how far, by the filter or, if less, its link.

        Args:
            marker: its number.
            expected: [m] its place.
            stddev_px: [px] one standard deviation of it.
            parent: the marker before it, None when that one is not in sight.
        """
        by_filter = WINDOW_SIGMAS * stddev_px
        if parent is not None:
            by_link = LINK_SLACK * self._length_before(marker) * self._view.pixels_per_metre
            if by_link < by_filter:
                return (parent.spot.u, parent.spot.v), by_link
        return self._view.plane.to_pixel(expected), by_filter

    def _length_before(self, marker: int) -> float:
        """Return the distance [m] of a marker from the one before it."""
        geometry = self._view.geometry
        return geometry.base_marker_m if marker == 1 else geometry.layout.link_lengths_m[marker - 2]

    def _best(
        self,
        frame: FollowedFrame,
        marker: int,
        candidates: Sequence[Candidate],
        expected: tuple[Place, Spread],
        seen: list[Seen | None],
    ) -> Sighting | None:
        """Return the candidate that fits a marker's expected place and covariance best; None when none does."""
        parent, placement = seen[-1] if seen else None, frame.options.placement_stddev_m
        sightings = [
            sighting
            for candidate in candidates
            if not self._belongs_elsewhere(candidate.spot, self._predicted[marker], seen, frame.rivals)
            for sighting in [locate(candidate, self._appearances[marker], self._view.diameter_px, placement, expected)]
            if sighting.distance <= GATE and self._fits_link(marker, parent, sighting)
        ]
        return min(sightings, key=lambda sighting: sighting.distance, default=None)

    def _belongs_elsewhere(
        self, spot: Spot, predicted_px: Place, seen: list[Seen | None], rivals: Sequence[Place]
    ) -> bool:
        """Whether another marker of this finger has the spot, or another finger has as good a claim to it."""
        place = spot.u, spot.v
        near = 0.5 * self._view.diameter_px
        if any(other is not None and math.dist(other.spot[:2], place) < near for other in seen):
            return True
        claim = min([math.dist(rival, place) for rival in rivals], default=math.inf)
        return claim < near and claim < math.dist(place, predicted_px) + 0.5 * near

    def _fits_link(self, marker: int, parent: Seen | None, sighting: Sighting) -> bool:
        """Whether distance and turn from the marker before are possible; true when that one is not in sight."""
        if parent is None:
            return True
        step = sighting.point[0] - parent.point[0], sighting.point[1] - parent.point[1]
        length = self._length_before(marker)
        blur = 3.0 * math.sqrt(sighting.noise.xx + sighting.noise.yy)
        if abs(math.hypot(*step) - length) > LINK_TOLERANCE[0] + LINK_TOLERANCE[1] * length + blur:
            return False
        if marker == 1:
            return True
        heading = self.filter.heading(marker - 2)
        turn = (heading - math.atan2(step[1], step[0]) + math.pi) % (2 * math.pi) - math.pi
        return JOINT_RANGE[0] <= turn <= JOINT_RANGE[1]

    def _returns(self, marker: int, sighting: Sighting, stddev_px: float, stamp: float) -> bool:
        """Whether a spot is a marker that was out of sight.

        It has to look the same, surroundings included; and unless its place was sure, it has to be seen a second
        time, no further away than a joint can have moved.
        """
        before = self._returning.pop(marker, None)
        if not self._appearances[marker].resembles(sighting.spot, sighting.surround):
            return False
        if stddev_px <= SURE_SHARE * self._view.diameter_px:
            return True
        if before is not None:
            stamp_before, point = before
            geometry = self._view.geometry
            length = max(*geometry.layout.link_lengths_m, geometry.base_marker_m)
            if math.dist(point, sighting.point) <= FASTEST_JOINT * length * (stamp - stamp_before):
                return True
        self._returning[marker] = stamp, sighting.point
        return False
