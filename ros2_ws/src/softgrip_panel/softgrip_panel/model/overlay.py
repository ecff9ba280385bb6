# SPDX-License-Identifier: Apache-2.0
"""Where the predicted and the measured finger lie in the camera's picture."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from softgrip_model import profile
from softgrip_model.profile import ProfileError
from softgrip_vision import calibration
from softgrip_vision.errors import VisionError

Pixels = tuple[tuple[float, float], ...]


class ChainOverlay:
    """Draws chains of one finger; without profiles or calibration the prediction has no place and is left out.

    Args:
        finger: in front of the camera.
        profiles: folder of finger profiles, empty = none.
        calibration_file: of the camera, empty = none; it may appear later.
    """

    def __init__(self, finger: str, profiles: str, calibration_file: str) -> None:
        self._finger = finger
        self._profiles = Path(profiles) if profiles else None
        self._calibration_file = Path(calibration_file) if calibration_file else None
        self._plane: calibration.PlaneMap | None = None
        self._link_lengths_m: Sequence[float] = ()
        self._mounted = ""
        self._angles: tuple[float, ...] = ()
        self._tip_m = (math.nan, math.nan)
        self._measured: Pixels = ()
        self.problem = ""

    def mount(self, profiles: Mapping[str, str]) -> None:
        """Take which profile each slot holds."""
        mounted = profiles.get(self._finger, "")
        if mounted == self._mounted:
            return
        self._mounted, self._link_lengths_m = mounted, ()
        if self._profiles is None or not mounted or "/" in mounted:
            return
        try:
            design = profile.load(self._profiles / f"{mounted}.yaml").finger(self._finger)
        except (OSError, ProfileError, KeyError) as error:
            self.problem = str(error)
            return
        self._link_lengths_m = design.link_lengths_m

    def predict(self, fingers: Mapping[str, tuple[Sequence[float], tuple[float, float]]]) -> None:
        """Take predicted joint angles [rad] and tip [m] by finger."""
        angles, self._tip_m = fingers.get(self._finger, ((), (math.nan, math.nan)))
        self._angles = tuple(angles) if all(map(math.isfinite, (*angles, *self._tip_m))) else ()

    def measure(self, finger: str, pixels: Sequence[tuple[float, float]]) -> None:
        """Take the markers of a finger, base to tip [px]."""
        if finger == self._finger:
            self._measured = tuple((float(u), float(v)) for u, v in pixels if math.isfinite(u) and math.isfinite(v))

    def lines(self) -> dict[str, Pixels]:
        """Return chains to draw by name."""
        found: dict[str, Pixels] = {}
        if self._measured:
            found["measured"] = self._measured
        if self._angles and len(self._link_lengths_m) == len(self._angles) and self._has_plane():
            assert self._plane is not None
            found["predicted"] = tuple(self._plane.to_pixel(point) for point in self._chain_m())
        return found

    def _chain_m(self) -> list[tuple[float, float]]:
        """Return the points from the first joint to the tip in the finger's plane [m], closing towards -y.

        The tip is the prediction's own, since flexures bend over their length.
        """
        headings = [-angle for angle in itertools.accumulate(self._angles)]
        points = [(0.0, 0.0)]
        for length_m, heading in zip(self._link_lengths_m[:-1], headings[:-1], strict=True):
            x, y = points[-1]
            points.append((x + length_m * math.cos(heading), y + length_m * math.sin(heading)))
        return [*points, self._tip_m]

    def _has_plane(self) -> bool:
        """Read the calibration once it is there."""
        if self._plane is None and self._calibration_file is not None and self._calibration_file.exists():
            try:
                found = calibration.load(self._calibration_file)
                self._plane = calibration.PlaneMap(found.lens, found.plane(self._finger))
            except VisionError as error:
                self.problem, self._calibration_file = str(error), None
        return self._plane is not None
