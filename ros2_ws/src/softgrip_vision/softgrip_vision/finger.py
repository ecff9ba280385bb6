# SPDX-License-Identifier: Apache-2.0
"""From frames to the joint angles of one finger: search it, follow it, say what is known, notice when it is lost.

A search of the whole image (search.py) finds the chain; from then on it is followed from frame to frame (following.py).
Angles and tip are the state of the chain's filter. When too little is seen, or something is missing for too long, the
whole image is searched once more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from softgrip_vision.calibration import CameraCalibration, PlaneMap
from softgrip_vision.chain import ChainFilter, ChainGeometry, Place
from softgrip_vision.colour import ColourModel, Image
from softgrip_vision.errors import FrameError
from softgrip_vision.following import FollowedChain, FollowedFinger, FollowedFrame
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.marker_appearance import alike
from softgrip_vision.options import TrackerOptions
from softgrip_vision.readings import FingerPose, FingerReading, MarkerReading
from softgrip_vision.search import find_chain, search_spots
from softgrip_vision.sightings import Seen, threshold_quality
from softgrip_vision.spots import Window

#: [s] A gap between frames after which nothing is predicted any more.
LONGEST_GAP = 0.5
#: With more markers out of sight than this, the whole image is searched at once.
MAX_HIDDEN = 2


@dataclass
class FingerTracker:
    """Measures one finger in frame after frame.

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
        plane_map = PlaneMap(lens, plane)
        pixels_per_metre = plane_map.pixels_per_metre(np.zeros(2))
        self._view = FollowedFinger(
            ChainGeometry(self.layout, plane.base_marker_m),
            plane_map,
            plane.marker_diameter_m * pixels_per_metre,
            pixels_per_metre,
        )
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
        self._chain: FollowedChain | None = None
        self._stamp = math.nan
        self._last_sound = math.nan
        self._last_complete = math.nan

    def advance(self, stamp: float) -> Sequence[Place]:
        """Predict to the time of the next frame [s]; return the (n + 2,) places [px] where the markers are expected.

        None of them when the finger is not being followed. Call once per frame, before :meth:`measure`.
        """
        if self._chain is not None and not 0 < stamp - self._stamp <= LONGEST_GAP:
            self.reset()
        return [] if self._chain is None else self._chain.predict(stamp - self._stamp)

    def measure(self, image: Image, stamp: float, rivals: Sequence[Place]) -> FingerReading:
        """Measure the finger in one frame.

        Args:
            image: (h, w, 3) BGR.
            stamp: [s] of capture, as given to :meth:`advance`.
            rivals: [px] where the markers of other fingers are expected.
        """
        self._stamp = stamp
        frame = FollowedFrame(image, stamp, rivals, self.options)
        if self._chain is None:
            problem = self._acquire(image)
            if problem:
                return self.silent(problem)
            self._last_sound = stamp
            return self._confirm(frame)
        seen = self._chain.follow(frame)
        doubtful = seen.count(None) > MAX_HIDDEN or stamp - self._last_complete > self.options.reacquire_timeout_s
        # A joint may have moved faster than predicted, or a marker changed its looks for good.
        if doubtful and not self._acquire(image):
            return self._confirm(frame)
        return self._conclude(self._chain.filter, seen, stamp)

    def _acquire(self, image: Image) -> str:
        """Search the region; return why nothing was found, or an empty text."""
        spots = search_spots(image, self._region, ColourModel(self.setup.hue_deg), self._view.diameter_px)
        found = find_chain(spots, self._view.plane, self._view.geometry)
        if found is None:
            return (
                f"expected a chain of {self.layout.joints + 2} markers for profile '{self.profile}', found "
                f"{len(spots)} spots of that colour and size that do not form it; check light, markers, profile and "
                "calibration"
            )
        side = alike(image, found.spots)
        if side is None:
            return "the markers found differ in size, colour or surroundings; is something green in the picture?"
        self._chain = FollowedChain(self._view, image, found, side)
        return ""

    def _confirm(self, frame: FollowedFrame) -> FingerReading:
        """Conclude on a chain just found: every one of its markers has to stand the test of following."""
        assert self._chain is not None
        seen = self._chain.follow(frame)
        if None in seen:
            self.reset()
            return self.silent("a chain was found that does not hold; searching the whole image")
        return self._conclude(self._chain.filter, seen, frame.stamp)

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
        pixel = np.array(self._view.plane.to_pixel(point))
        deviation = math.sqrt((spread.xx + spread.yy) / 2) * self._view.pixels_per_metre
        return MarkerReading(name, pixel, np.array(point), deviation, 0.0, occluded=True)

    def silent(self, problem: str) -> FingerReading:
        """Return a reading that says only why there is none."""
        unknown = np.full(2, math.nan)
        markers = tuple(
            MarkerReading(name, unknown, unknown, math.nan, 0.0, occluded=True) for name in self.layout.marker_names
        )
        return FingerReading(self.setup.name, self.profile, markers, 0.0, None, f"{self.setup.name}: {problem}")
