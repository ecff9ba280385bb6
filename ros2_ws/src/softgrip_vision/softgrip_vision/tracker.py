# SPDX-License-Identifier: Apache-2.0
"""Any number of fingers in the frames of one camera. The outcome depends on the frames and their stamps alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from softgrip_model.digest import text_digest
from softgrip_vision.calibration import CameraCalibration
from softgrip_vision.colour import Image
from softgrip_vision.errors import FrameError, LayoutError
from softgrip_vision.finger import FingerTracker
from softgrip_vision.layout import Chains, FingerSetup
from softgrip_vision.options import TrackerOptions
from softgrip_vision.readings import FingerReading


@dataclass
class Tracker:
    """Follows any number of fingers in the frames of one camera.

    Args:
        fingers: which, with colour and region.
        chains: of every profile that may be mounted.
        calibration: of the camera.
        profile: taken to be mounted in every slot until :meth:`mount` says otherwise.
        options: what a user may set.
    """

    fingers: tuple[FingerSetup, ...]
    chains: Chains
    calibration: CameraCalibration
    profile: str
    options: TrackerOptions = field(default_factory=TrackerOptions)

    def __post_init__(self) -> None:
        names = [setup.name for setup in self.fingers]
        if len(set(names)) != len(names):
            raise LayoutError(f"expected fingers with different names, found {names}")
        self._trackers = {setup.name: self._tracker(setup, self.profile) for setup in self.fingers}
        self._unknown: dict[str, str] = {}
        self._stamp = math.nan

    def _tracker(self, setup: FingerSetup, profile: str) -> FingerTracker:
        if profile not in self.chains:
            raise LayoutError(f"expected a profile of {sorted(self.chains)}, found '{profile}'")
        chains = self.chains[profile]
        if setup.name not in chains:
            raise LayoutError(f"profile '{profile}' has no finger '{setup.name}'; it has {sorted(chains)}")
        return FingerTracker(setup, profile, chains[setup.name], self.calibration, self.options)

    def mount(self, finger: str, profile: str) -> None:
        """Note that another finger profile sits in a slot.

        Raises:
            LayoutError: when there is no chain for it: that finger is not measured until it has a known one again.
        """
        current = self._trackers.get(finger)
        if current is None or (current.profile == profile and finger not in self._unknown):
            return
        try:
            self._trackers[finger] = self._tracker(current.setup, profile)
        except LayoutError as error:
            self._unknown[finger] = str(error)
            raise
        self._unknown.pop(finger, None)

    @property
    def profiles_text(self) -> str:
        """Which profile is taken to sit in which slot, in words."""
        return ", ".join(
            f"{name}: {'unknown' if name in self._unknown else tracker.profile}"
            for name, tracker in self._trackers.items()
        )

    @property
    def configuration(self) -> str:
        """Digest of all that the numbers depend on besides the frames: calibration, fingers, chains, options."""
        layouts = [tracker.layout for tracker in self._trackers.values()]
        # an option's former name: bags recorded with it stay comparable
        options = repr(self.options).replace("reacquire_timeout_s=", "patience=")
        text = f"({self.calibration.digest!r}, {self.fingers!r}, {layouts!r}, {self.profiles_text!r}, {options})"
        return text_digest(text)

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
            rivals = [place for other, places in expected.items() if other != name for place in places]
            unknown = self._unknown.get(name)
            readings.append(tracker.silent(unknown) if unknown else tracker.measure(image, stamp, rivals))
        return tuple(readings)
