# SPDX-License-Identifier: Apache-2.0
"""From frames to joint angles: one finger's markers, followed from frame to frame.

Per frame: predict the chain; look for each marker, base to tip, in a small window where the chain says it is, refined
by every marker already found; accept the spot that fits place, size and colour, or none; angles and tip are the filter's
state. When too little is seen for too long, search the whole image again (search.py). The outcome depends on the frames
and their stamps alone.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import Calibration, PlaneMap
from softgrip_vision.chain import ChainFilter, ChainGeometry
from softgrip_vision.colour import ColourModel, Image, hue_of
from softgrip_vision.errors import FrameError, LayoutError
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.readings import FingerPose, FingerReading, MarkerReading
from softgrip_vision.search import FoundChain, find_chain, search_spots
from softgrip_vision.spots import Spot, Window, find_spots, window_around

Array = NDArray[np.float64]

#: Squared Mahalanobis distance within which a spot may be the marker (chi-square, 2 degrees of freedom: 99.97 %).
GATE = 16.0
#: Windows reach this many deviations of the expected place, and are at most this large [px].
WINDOW_SIGMAS = 4.0
LARGEST_WINDOW_HALF_PX = 160.0
#: Hues this far from the finger's own, once known, give no signal [deg].
KNOWN_HUE_HALF_ANGLE = 40.0
#: Share of a new frame in what is remembered of a marker's looks.
MEMORY = 0.2
#: [s] A gap between frames after which nothing is predicted any more.
LONGEST_GAP = 0.5


@dataclass(frozen=True)
class TrackerOptions:
    """What a user may set.

    Attributes:
        threshold_share: 0..1 of the markers' height in the signal at which a pixel counts as marker.
        placement_stddev_m: [m] how exactly the markers sit where the layout says.
        largest_angle_stddev: [rad] a pose less certain than that is not given out.
        patience: [s] markers may be hidden so long before the finger is searched for anew.
    """

    threshold_share: float = 0.4
    placement_stddev_m: float = 5e-5
    largest_angle_stddev: float = math.radians(2.0)
    patience: float = 0.7


class Looks(NamedTuple):
    """What is remembered of a marker."""

    area_px: float
    height: float


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
    calibration: Calibration
    options: TrackerOptions = field(default_factory=TrackerOptions)

    def __post_init__(self) -> None:
        plane = self.calibration.plane(self.setup.name)
        lens = self.calibration.lens
        self._map = PlaneMap(lens, plane)
        self._geometry = ChainGeometry(self.layout, plane.base_marker_m)
        self._diameter_px = plane.marker_diameter_m * self._map.pixels_per_metre(np.array([[0.0, 0.0]])[0])
        self._marker_diameter_m = plane.marker_diameter_m
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
        self._looks: list[Looks] = []
        self._colour = ColourModel(self.setup.hue_deg)
        self._stamp = math.nan
        self._last_sound = math.nan

    @property
    def locked(self) -> bool:
        """Whether the finger's chain is being followed."""
        return self._filter is not None

    def measure(self, image: Image, stamp: float) -> FingerReading:
        """Measure the finger in one (h, w, 3) BGR frame captured at ``stamp`` [s], later than the one before."""
        if self._filter is not None and not 0 < stamp - self._stamp <= LONGEST_GAP:
            self.reset()
        if self._filter is None:
            problem = self._acquire(image)
            if problem:
                return self._silent(problem)
            self._last_sound = stamp
        else:
            self._filter.predict(stamp - self._stamp)
        self._stamp = stamp
        assert self._filter is not None
        spots = [self._follow(image, self._filter, marker) for marker in range(self.layout.joints + 2)]
        return self._conclude(self._filter, spots, stamp)

    def _acquire(self, image: Image) -> str:
        """Search the region; return why nothing was found, or an empty text."""
        self._colour = ColourModel(self.setup.hue_deg)
        spots = search_spots(image, self._region, self._colour, self._diameter_px)
        wanted = self.layout.joints + 2
        found = find_chain(spots, self._map, self._geometry)
        if found is None:
            return (
                f"expected a chain of {wanted} markers for profile '{self.profile}', found {len(spots)} spots of that "
                "colour and size that do not form it; check light, markers, profile and calibration"
            )
        self._start(image, found)
        return ""

    def _start(self, image: Image, found: FoundChain) -> None:
        colours = [_colour_at(image, spot) for spot in found.spots]
        self._colour = ColourModel(hue_of(np.median(colours, axis=0)), KNOWN_HUE_HALF_ANGLE)
        self._looks = [Looks(spot.area_px, spot.height) for spot in found.spots]
        self._filter = ChainFilter(self._geometry)
        self._filter.place(found.points)

    def _follow(self, image: Image, chain: ChainFilter, marker: int) -> tuple[Spot, float] | None:
        """Look for one marker where the chain expects it; take it in; return the spot and its confidence."""
        expected, spread = chain.expect(marker)
        pixel = self._map.to_pixels(expected[None, :])
        _, (jacobian,) = self._map.to_plane_with_jacobian(pixel)
        to_pixels = np.linalg.inv(jacobian)
        reach = math.sqrt(max(0.0, float(np.linalg.eigvalsh(to_pixels @ spread @ to_pixels.T)[-1])))
        half = min(LARGEST_WINDOW_HALF_PX, WINDOW_SIGMAS * reach + 0.9 * self._diameter_px + 3.0)
        window = window_around(pixel[0], half, (image.shape[1], image.shape[0]))
        if window is None:
            return None
        looks = self._looks[marker]
        threshold = self.options.threshold_share * looks.height
        area_range = (0.6 * looks.area_px, 1.6 * looks.area_px)
        best: tuple[float, Spot, Array, Array] | None = None
        for spot in find_spots(image, window, self._colour, threshold, area_range):
            (point,), (jacobian,) = self._map.to_plane_with_jacobian(np.array([[spot.u, spot.v]]))
            noise = jacobian @ jacobian.T * spot.stddev_px**2 + np.eye(2) * self.options.placement_stddev_m**2
            miss = point - expected
            distance = float(miss @ np.linalg.solve(spread + noise, miss))
            if distance <= GATE and (best is None or distance < best[0]):
                best = distance, spot, point, noise
        if best is None:
            return None
        distance, spot, point, noise = best
        chain.update(marker, point, noise)
        confidence = _confidence(spot, looks, distance)
        self._looks[marker] = Looks(
            looks.area_px + MEMORY * (spot.area_px - looks.area_px),
            looks.height + MEMORY * (spot.height - looks.height),
        )
        return spot, confidence

    def _conclude(self, chain: ChainFilter, seen: list[tuple[Spot, float] | None], stamp: float) -> FingerReading:
        names = self.layout.marker_names
        hidden = [name for name, found in zip(names, seen, strict=True) if found is None]
        if len(hidden) <= 2:
            self._last_sound = stamp
        elif stamp - self._last_sound > self.options.patience or len(names) - len(hidden) < 2:
            self.reset()
            return self._silent(f"lost: {', '.join(hidden)} not seen; searching the whole image")
        markers = tuple(self._reading(chain, index, found) for index, found in enumerate(seen))
        quality = threshold_quality([found[0] for found in seen if found is not None])
        angles, angles_stddev = chain.angles()
        tip, tip_stddev = chain.tip()
        if float(angles_stddev.max()) > self.options.largest_angle_stddev:
            joint = int(np.argmax(angles_stddev))
            why = f"{', '.join(hidden)} not seen" if hidden else "markers just found"
            problem = f"angle of joint {joint} known to {math.degrees(angles_stddev[joint]):.1f} deg only: {why}"
            return FingerReading(self.setup.name, self.profile, markers, quality, None, problem)
        pose = FingerPose(angles, angles_stddev, tip, tip_stddev)
        return FingerReading(self.setup.name, self.profile, markers, quality, pose)

    def _reading(self, chain: ChainFilter, marker: int, found: tuple[Spot, float] | None) -> MarkerReading:
        name = self.layout.marker_names[marker]
        if found is not None:
            spot, confidence = found
            pixel = np.array([spot.u, spot.v])
            point = self._map.to_plane(pixel[None, :])[0]
            return MarkerReading(name, pixel, point, spot.stddev_px, confidence, occluded=False)
        point, spread = chain.expect(marker)
        pixel = self._map.to_pixels(point[None, :])[0]
        deviation = math.sqrt(float(np.trace(spread)) / 2) * self._diameter_px / self._marker_diameter_m
        return MarkerReading(name, pixel, point, deviation, 0.0, occluded=True)

    def _silent(self, problem: str) -> FingerReading:
        unknown = np.full(2, math.nan)
        markers = tuple(
            MarkerReading(name, unknown, unknown, math.nan, 0.0, occluded=True) for name in self.layout.marker_names
        )
        return FingerReading(self.setup.name, self.profile, markers, 0.0, None, f"{self.setup.name}: {problem}")


def threshold_quality(spots: list[Spot]) -> float:
    """Return 0..1 how well markers stand out: the between-class share of the signal's variance, h^2 / (h^2 + (2 s)^2).

    h is the markers' median height over their surroundings and s the surroundings' noise; 0.5 means that markers are
    two deviations high, and 0 that none was seen.
    """
    if not spots:
        return 0.0
    height = float(np.median([spot.height for spot in spots]))
    noise = float(np.median([spot.noise for spot in spots]))
    return height**2 / (height**2 + (2.0 * noise) ** 2)


def _confidence(spot: Spot, looks: Looks, distance: float) -> float:
    size = math.exp(-0.5 * (math.log(spot.area_px / looks.area_px) / 0.25) ** 2)
    contrast = 1.0 - math.exp(-spot.height / (4.0 * spot.noise))
    return size * contrast * spot.solidity * math.exp(-0.5 * distance / GATE)


def _colour_at(image: Image, spot: Spot) -> NDArray[np.float64]:
    row, column = round(spot.v), round(spot.u)
    patch = image[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
    return np.asarray(patch.reshape(-1, 3).mean(axis=0), dtype=np.float64)


@dataclass
class Tracker:
    """Follows any number of fingers in the frames of one camera.

    Args:
        fingers: which, with colour and region.
        chains: profile id to chain.
        calibration: of the camera.
        options: what a user may set.
    """

    fingers: tuple[FingerSetup, ...]
    chains: dict[str, ChainLayout]
    calibration: Calibration
    profile: str
    options: TrackerOptions = field(default_factory=TrackerOptions)

    def __post_init__(self) -> None:
        if self.profile not in self.chains:
            raise LayoutError(f"expected a profile of {sorted(self.chains)}, found '{self.profile}'")
        names = [setup.name for setup in self.fingers]
        if len(set(names)) != len(names):
            raise LayoutError(f"expected fingers with different names, found {names}")
        self._trackers = {setup.name: self._tracker(setup, self.profile) for setup in self.fingers}
        self._stamp = math.nan

    def _tracker(self, setup: FingerSetup, profile: str) -> FingerTracker:
        return FingerTracker(setup, profile, self.chains[profile], self.calibration, self.options)

    def mount(self, finger: str, profile: str) -> None:
        """Note that another finger profile sits in a slot; a profile that is not in the chains is refused.

        Raises:
            FrameError: when the profile is unknown; the tracker goes on with the one before.
        """
        current = self._trackers.get(finger)
        if current is None or current.profile == profile:
            return
        if profile not in self.chains:
            raise FrameError(f"finger '{finger}': expected a profile of {sorted(self.chains)}, found '{profile}'")
        self._trackers[finger] = self._tracker(current.setup, profile)

    @property
    def profiles_text(self) -> str:
        """Which profile is taken to sit in which slot, in words."""
        return ", ".join(f"{name}: {tracker.profile}" for name, tracker in self._trackers.items())

    @property
    def configuration(self) -> str:
        """Digest of all that the numbers depend on besides the frames: calibration, fingers, chains, options."""
        text = repr(
            (self.calibration.digest, self.fingers, sorted(self.chains.items()), self.profiles_text, self.options)
        )
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def set_options(self, options: TrackerOptions) -> None:
        """Change what a user may set, live."""
        self.options = options
        for tracker in self._trackers.values():
            tracker.options = options

    def measure(self, image: Image, stamp: float) -> tuple[FingerReading, ...]:
        """Measure every finger in a frame.

        Args:
            image: (h, w, 3) BGR uint8.
            stamp: [s] of capture.

        Raises:
            FrameError: when the frame is no colour image, or not newer than the last.
            CalibrationError: when it is not of the calibrated size.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise FrameError(f"expected an 8-bit colour image (h, w, 3), found {image.dtype} {image.shape}")
        self.calibration.require_size(image.shape[1], image.shape[0])
        if stamp <= self._stamp:
            behind = self._stamp - stamp
            if behind < 1.0:
                raise FrameError(f"expected frames in order of capture, found one {behind:.3f} s before the last")
            for tracker in self._trackers.values():
                tracker.reset()
        self._stamp = stamp
        return tuple(tracker.measure(image, stamp) for tracker in self._trackers.values())
