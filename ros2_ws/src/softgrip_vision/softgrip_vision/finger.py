# SPDX-License-Identifier: Apache-2.0
"""From frames to joint angles: one finger's markers, followed from frame to frame.

Per frame: predict the chain; look at once in small windows around every marker's predicted place, where nearly all are.
Then, base to tip, the chain says where a marker has to be, refined by every marker already found; accept the spot that
fits place, size and colour; if none does, look wherever the marker can be. Angles and tip are the state of the filter.
A marker that was out of sight has to prove itself (:meth:`FingerTracker._returns`). When too little is seen, or
something is missing for too long, search the whole image for the whole chain (search.py).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import CameraCalibration, PlaneMap
from softgrip_vision.chain import ChainFilter, ChainGeometry, Place, Spread
from softgrip_vision.colour import ColourModel, Image, hue_of
from softgrip_vision.errors import FrameError
from softgrip_vision.layout import JOINT_RANGE, ChainLayout, FingerSetup
from softgrip_vision.marker_appearance import (
    MAX_AREA,
    BodySide,
    MarkerAppearance,
    alike,
    colours_at,
    sharp_area,
    surrounds_of,
)
from softgrip_vision.readings import FingerPose, FingerReading, MarkerReading
from softgrip_vision.search import FoundChain, find_chain, search_spots
from softgrip_vision.sightings import Candidate, Seen, Sighting, candidates_of, locate, threshold_quality
from softgrip_vision.spots import Spot, Window, find_spots, window_around


@dataclass(frozen=True)
class TrackerOptions:
    """Of all fingers.

    Attributes:
        threshold_share: 0..1 of the markers' height in the signal at which a pixel counts as marker.
        placement_stddev_m: [m] how exactly the markers sit where the layout says.
        largest_angle_stddev: [rad] a pose less certain than that is not given out.
        reacquire_timeout_s: markers may be hidden so long before the finger is searched for again.
    """

    threshold_share: float = 0.4
    placement_stddev_m: float = 5e-5
    largest_angle_stddev: float = math.radians(2.0)
    reacquire_timeout_s: float = 0.7


Array = NDArray[np.float64]

#: Squared Mahalanobis distance within which a spot may be the marker (chi-square, 2 degrees of freedom: 99.97 %).
GATE = 16.0
#: Squared Mahalanobis distance up to which a spot need not have the marker's surroundings as well, and one near the
#: predicted place is not compared with what lies farther away.
UNSURPRISING = 4.0
#: Windows reach this many deviations of the expected place, and are at most this large [px].
WINDOW_SIGMAS = 4.0
LARGEST_WINDOW_HALF_PX = 160.0
#: [marker diameters] The windows looked at first reach this far around the predicted places.
NEAR_REACH = 0.5
#: Hues this far from the finger's own, once known, give no signal [deg].
KNOWN_HUE_HALF_ANGLE = 40.0
#: [s] A gap between frames after which nothing is predicted any more.
LONGEST_GAP = 0.5
#: A place expected to better than this share of a marker's diameter leaves no room for another marker.
SURE_REACH = 0.3
#: When the marker before it on the chain is hidden, a marker is taken only at a place expected to this many of its
#: diameters: when it was in sight just now, and when it comes back.
STAYING_REACH, RETURNING_REACH = 1.5, 0.8
#: With more markers out of sight than this, the whole image is searched at once.
MAX_HIDDEN = 2
#: [m] and relative: how far the distance to the marker before may be off the link's length.
LINK_TOLERANCE = (0.5e-3, 0.02)
#: A link looks at most so much longer than where the first joint is: perspective, and the tolerance above.
LINK_SLACK = 1.25
#: [rad/s] faster than this no joint moves; between two sightings of a marker that comes back.
FASTEST_JOINT = 12.0


@dataclass
class FingerTracker:
    """Follows one finger.

    Args:
        setup: name, colour, region.
        profile: id of the finger profile mounted.
        layout: its chain.
        calibration: lens and planes.
        options: what a user may set.
    """

    setup: FingerSetup
    profile: str
    layout: ChainLayout
    calibration: CameraCalibration
    options: TrackerOptions = field(default_factory=TrackerOptions)

    def __post_init__(self) -> None:
        plane = self.calibration.plane(self.setup.name)
        lens = self.calibration.lens
        self._map = PlaneMap(lens, plane)
        self._geometry = ChainGeometry(self.layout, plane.base_marker_m)
        self._pixels_per_metre = self._map.pixels_per_metre(np.zeros(2))
        self._diameter_px = plane.marker_diameter_m * self._pixels_per_metre
        left, top, width, height = self.setup.region or (0, 0, lens.width, lens.height)
        self._region = Window(left, top, min(width, lens.width - left), min(height, lens.height - top))
        if self._region.width < 8 or self._region.height < 8:
            raise FrameError(
                f"finger '{self.setup.name}': expected a region inside the image of {lens.width}x{lens.height}, "
                f"found {self.setup.region}"
            )
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; the next frame is searched."""
        self._filter: ChainFilter | None = None
        self._predicted: list[Place] = []
        self._appearances: list[MarkerAppearance] = []
        self._side = BodySide.BRIGHTER
        self._colour = ColourModel(self.setup.hue_deg)
        self._stamp = math.nan
        self._last_sound = math.nan
        self._last_complete = math.nan
        self._in_sight: list[bool] = []
        self._returning: dict[int, tuple[float, Place]] = {}

    def advance(self, stamp: float) -> Sequence[Place]:
        """Predict to the time of the next frame [s]; return the (n + 2,) places [px] where the markers are expected.

        None of them when the finger is not being followed. Call once per frame, before :meth:`measure`.
        """
        if self._filter is not None and not 0 < stamp - self._stamp <= LONGEST_GAP:
            self.reset()
        if self._filter is None:
            return self._predicted
        self._filter.predict(stamp - self._stamp)
        places = self._map.to_pixels(self._geometry.markers(self._filter.state))
        self._predicted = [(u, v) for u, v in places.tolist()]
        return self._predicted

    def measure(self, image: Image, stamp: float, rivals: Sequence[Place]) -> FingerReading:
        """Measure the finger in one frame.

        Args:
            image: (h, w, 3) BGR.
            stamp: [s] of capture, as given to :meth:`advance`.
            rivals: [px] where the markers of other fingers are expected.
        """
        self._stamp = stamp
        if self._filter is None:
            problem = self._acquire(image)
            if problem:
                return self.silent(problem)
            self._last_sound = stamp
            return self._confirm(image, rivals, stamp)
        seen = self._follow_all(image, self._filter, rivals)
        doubtful = seen.count(None) > MAX_HIDDEN or stamp - self._last_complete > self.options.reacquire_timeout_s
        # A joint may have moved faster than predicted, or a marker changed its looks for good.
        if doubtful and not self._acquire(image):
            return self._confirm(image, rivals, stamp)
        return self._conclude(self._filter, seen, stamp)

    def _confirm(self, image: Image, rivals: Sequence[Place], stamp: float) -> FingerReading:
        """Conclude on a chain just found: every one of its markers has to stand the test of following."""
        assert self._filter is not None
        seen = self._follow_all(image, self._filter, rivals)
        if None in seen:
            self.reset()
            return self.silent("a chain was found that does not hold; searching the whole image")
        return self._conclude(self._filter, seen, stamp)

    def _follow_all(self, image: Image, chain: ChainFilter, rivals: Sequence[Place]) -> list[Seen | None]:
        seen: list[Seen | None] = []
        markers = range(self.layout.joints + 2)
        near = self._look(image, markers, self._predicted, NEAR_REACH * self._diameter_px)
        for marker in markers:
            seen.append(self._follow(image, chain, marker, near[marker], seen, rivals))
        self._in_sight = [found is not None for found in seen]
        area = sharp_area(self._appearances[0].area_px, [found.spot for found in seen if found is not None])
        self._appearances = [appearance._replace(area_px=area) for appearance in self._appearances]
        return seen

    def _acquire(self, image: Image) -> str:
        """Search the region; return why nothing was found, or an empty text."""
        spots = search_spots(image, self._region, ColourModel(self.setup.hue_deg), self._diameter_px)
        found = find_chain(spots, self._map, self._geometry)
        if found is None:
            return (
                f"expected a chain of {self.layout.joints + 2} markers for profile '{self.profile}', found "
                f"{len(spots)} spots of that colour and size that do not form it; check light, markers, profile and "
                "calibration"
            )
        side = alike(image, found.spots)
        if side is None:
            return "the markers found differ in size, colour or surroundings; is something green in the picture?"
        self._start(image, found, side)
        return ""

    def _start(self, image: Image, found: FoundChain, side: BodySide) -> None:
        self._side = side
        colour = np.median(colours_at(image, found.spots), axis=0)
        self._colour = ColourModel(hue_of(colour), KNOWN_HUE_HALF_ANGLE)
        # All markers of a finger have one size; the middle one of five is better known than each.
        area = statistics.median(spot.area_px for spot in found.spots)
        surrounds = surrounds_of(image, found.spots, side)
        self._appearances = [
            MarkerAppearance(area, spot.height, around) for spot, around in zip(found.spots, surrounds, strict=True)
        ]
        self._in_sight = [True] * len(found.spots)
        self._returning.clear()
        self._filter = ChainFilter(self._geometry)
        self._filter.place(found.points)
        self._predicted = [(spot.u, spot.v) for spot in found.spots]

    def _look(
        self, image: Image, markers: Sequence[int], places: Sequence[Place], clear: float
    ) -> list[list[Candidate]]:
        """Return, for each of some markers, what looks like it around its place.

        Args:
            image: (h, w, 3) BGR.
            markers: (k,) their numbers.
            places: (k,) [px] of each.
            clear: [px] spots whose centre is within this of the place are seen whole.
        """
        half = min(LARGEST_WINDOW_HALF_PX, clear + 0.9 * self._diameter_px + 3.0)
        size = image.shape[1], image.shape[0]
        windows = {
            marker: window
            for marker, place in zip(markers, places, strict=True)
            if (window := window_around(place, half, size)) is not None
        }
        if not windows:
            return [[] for _ in markers]
        thresholds = [self.options.threshold_share * self._appearances[marker].height for marker in windows]
        area = self._appearances[0].area_px
        spots = find_spots(image, list(windows.values()), self._colour, thresholds, (0.5 * area, MAX_AREA * area))
        admitted = {
            marker: [spot for spot in found if self._appearances[marker].admits(spot)]
            for marker, found in zip(windows, spots, strict=True)
        }
        all_spots = [spot for found in admitted.values() for spot in found]
        candidates = iter(candidates_of(image, all_spots, self._map, self._side))
        return [[next(candidates) for _ in admitted.get(marker, ())] for marker in markers]

    def _follow(
        self,
        image: Image,
        chain: ChainFilter,
        marker: int,
        near: Sequence[Candidate],
        seen: list[Seen | None],
        rivals: Sequence[Place],
    ) -> Seen | None:
        """Find one marker where the chain expects it and take it in.

        Args:
            image: (h, w, 3) BGR.
            chain: with all markers before this one taken in.
            marker: its number.
            near: what looks like it around its predicted place.
            seen: the markers before it, None for each that is hidden.
            rivals: [px] where the markers of other fingers are expected.
        """
        expected, spread = chain.expect(marker)
        reach = math.sqrt(spread.largest) * self._pixels_per_metre
        best = self._best(chain, marker, near, (expected, spread), seen, rivals)
        if best is None or best.distance > UNSURPRISING:
            place, clear = self._anywhere(marker, expected, reach, seen[-1] if seen else None)
            (anywhere,) = self._look(image, [marker], [place], clear)
            best = self._best(chain, marker, anywhere, (expected, spread), seen, rivals)
        if best is None:
            self._returning.pop(marker, None)
            return None
        appearance, parent = self._appearances[marker], seen[-1] if seen else None
        if best.distance > UNSURPRISING and not appearance.resembles(best.spot, best.surround):
            return None
        if parent is None and marker > 0:
            # Nothing near holds it: only a place that is well known will do.
            trusted = STAYING_REACH if self._in_sight[marker] else RETURNING_REACH
            if reach > trusted * self._diameter_px or not appearance.resembles(best.spot, best.surround):
                return None
        if not self._in_sight[marker] and not self._returns(marker, best, reach):
            return None
        chain.update(marker, best.point, best.noise)
        self._appearances[marker] = appearance.updated(best.spot, best.surround)
        return Seen(best.spot, best.point, appearance.confidence(best.spot, best.distance, GATE))

    def _anywhere(self, marker: int, expected: Place, reach: float, parent: Seen | None) -> tuple[Place, float]:
        """Return the place [px] around which a marker is looked for and how far, by the filter or, if less, its link.

        Args:
            marker: its number.
            expected: [m] its place.
            reach: [px] one standard deviation of it.
            parent: the marker before it, None when that one is not in sight.
        """
        by_filter = WINDOW_SIGMAS * reach
        if parent is not None:
            by_link = LINK_SLACK * self._length_before(marker) * self._pixels_per_metre
            if by_link < by_filter:
                return (parent.spot.u, parent.spot.v), by_link
        return self._map.to_pixel(expected), by_filter

    def _length_before(self, marker: int) -> float:
        """Return the distance [m] of a marker from the one before it."""
        return self._geometry.base_marker_m if marker == 1 else self.layout.link_lengths_m[marker - 2]

    def _best(
        self,
        chain: ChainFilter,
        marker: int,
        candidates: Sequence[Candidate],
        expected: tuple[Place, Spread],
        seen: list[Seen | None],
        rivals: Sequence[Place],
    ) -> Sighting | None:
        """Return the candidate that fits a marker's expected place and covariance best; None when none does."""
        parent, placement = seen[-1] if seen else None, self.options.placement_stddev_m
        sightings = [
            sighting
            for candidate in candidates
            if not self._belongs_elsewhere(candidate.spot, self._predicted[marker], seen, rivals)
            for sighting in [locate(candidate, self._appearances[marker], self._diameter_px, placement, expected)]
            if sighting.distance <= GATE and self._fits_link(chain, marker, parent, sighting)
        ]
        return min(sightings, key=lambda sighting: sighting.distance, default=None)

    def _belongs_elsewhere(self, spot: Spot, expected: Place, seen: list[Seen | None], rivals: Sequence[Place]) -> bool:
        """Whether another marker of this finger has the spot, or another finger has as good a claim to it."""
        place = spot.u, spot.v
        near = 0.5 * self._diameter_px
        if any(other is not None and math.dist(other.spot[:2], place) < near for other in seen):
            return True
        claim = min([math.dist(rival, place) for rival in rivals], default=math.inf)
        return claim < near and claim < math.dist(place, expected) + 0.5 * near

    def _fits_link(self, chain: ChainFilter, marker: int, parent: Seen | None, sighting: Sighting) -> bool:
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
        turn = (chain.heading(marker - 2) - math.atan2(step[1], step[0]) + math.pi) % (2 * math.pi) - math.pi
        return JOINT_RANGE[0] <= turn <= JOINT_RANGE[1]

    def _returns(self, marker: int, sighting: Sighting, reach: float) -> bool:
        """Whether a spot is a marker that was out of sight.

        It has to look the same, surroundings included; and unless its place was sure, it has to be seen a second
        time, no further away than a joint can have moved.
        """
        before = self._returning.pop(marker, None)
        if not self._appearances[marker].resembles(sighting.spot, sighting.surround):
            return False
        if reach <= SURE_REACH * self._diameter_px:
            return True
        if before is not None:
            stamp, point = before
            length = max(*self.layout.link_lengths_m, self._geometry.base_marker_m)
            if math.dist(point, sighting.point) <= FASTEST_JOINT * length * (self._stamp - stamp):
                return True
        self._returning[marker] = self._stamp, sighting.point
        return False

    def _conclude(self, chain: ChainFilter, seen: list[Seen | None], stamp: float) -> FingerReading:
        names = self.layout.marker_names
        hidden = [name for name, found in zip(names, seen, strict=True) if found is None]
        if not hidden:
            self._last_complete = stamp
        if len(hidden) <= MAX_HIDDEN:
            self._last_sound = stamp
        elif stamp - self._last_sound > self.options.reacquire_timeout_s:
            self.reset()
            return self.silent(f"lost: {', '.join(hidden)} not seen for too long; searching the whole image")
        unknown = chain.settle_hidden([found is None for found in seen])
        markers = tuple(self._reading(chain, index, found) for index, found in enumerate(seen))
        quality = threshold_quality([found.spot for found in seen if found is not None])
        angles, angles_stddev = chain.angles()
        angles_stddev = np.hypot(angles_stddev, unknown)
        tip, tip_stddev = chain.tip()
        if float(angles_stddev.max()) > self.options.largest_angle_stddev:
            joint = int(np.argmax(angles_stddev))
            known = f"angle of joint {joint} known to {math.degrees(angles_stddev[joint]):.1f} deg only"
            problem = f"{self.setup.name}: {known}: {', '.join(hidden) or 'nothing'} not seen"
            return FingerReading(self.setup.name, self.profile, markers, quality, None, problem)
        pose = FingerPose(angles, angles_stddev, tip, tip_stddev)
        return FingerReading(self.setup.name, self.profile, markers, quality, pose)

    def _reading(self, chain: ChainFilter, marker: int, found: Seen | None) -> MarkerReading:
        name = self.layout.marker_names[marker]
        if found is not None:
            spot, point, confidence = found
            return MarkerReading(name, np.array(spot[:2]), np.array(point), spot.stddev_px, confidence, occluded=False)
        point, spread = chain.expect(marker)
        pixel = np.array(self._map.to_pixel(point))
        deviation = math.sqrt((spread.xx + spread.yy) / 2) * self._pixels_per_metre
        return MarkerReading(name, pixel, np.array(point), deviation, 0.0, occluded=True)

    def silent(self, problem: str) -> FingerReading:
        """Return a reading that says only why there is none."""
        unknown = np.full(2, math.nan)
        markers = tuple(
            MarkerReading(name, unknown, unknown, math.nan, 0.0, occluded=True) for name in self.layout.marker_names
        )
        return FingerReading(self.setup.name, self.profile, markers, 0.0, None, f"{self.setup.name}: {problem}")
