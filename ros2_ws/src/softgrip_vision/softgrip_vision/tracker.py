# SPDX-License-Identifier: Apache-2.0
"""Any number of fingers in the frames of one camera. The outcome depends on the frames and their stamps alone."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field

import numpy as np

from softgrip_vision.calibration import Calibration
from softgrip_vision.colour import Image
from softgrip_vision.errors import FrameError, LayoutError
from softgrip_vision.finger import FingerTracker, TrackerOptions
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.readings import FingerReading

__all__ = ["Tracker", "TrackerOptions"]


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
        expected = {name: tracker.advance(stamp) for name, tracker in self._trackers.items()}
        readings = []
        for name, tracker in self._trackers.items():
            rivals = np.concatenate(
                [np.empty((0, 2)), *(places for other, places in expected.items() if other != name)]
            )
            readings.append(tracker.measure(image, stamp, rivals))
        return tuple(readings)
