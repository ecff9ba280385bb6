# SPDX-License-Identifier: Apache-2.0
"""How strongly a pixel shows a marker's colour: linear along one hue, so that centres stay sub-pixel.

With chroma coordinates alpha = R - (G + B)/2 and beta = sqrt(3)/2 (G - B) (the plane of the HSV hexagon), c is the
chroma along the marker's hue and o the chroma across it. The signal is

    s = c - |o| / tan(half_angle)

positive inside a cone of hues around the marker's. For green (120 deg) and 60 deg it is G - max(R, B). In contrast to
a threshold on hue it is linear in the light that a pixel mixes from marker and background, and it is 0 for any grey.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from softgrip_vision import _core

Image = NDArray[np.uint8]
Signal = NDArray[np.float32]


@dataclass(frozen=True)
class ColourModel:
    """A marker colour.

    Attributes:
        hue_deg: [deg] on the HSV circle.
        half_angle_deg: [deg] hues that far away give no signal.
    """

    hue_deg: float
    half_angle_deg: float = 60.0

    @cached_property
    def forms(self) -> list[list[float]]:
        """(2, 3): rows give c - o and c + o from (B, G, R), o scaled; the smaller of the two is c - |o|."""
        hue = math.radians(self.hue_deg)
        alpha = np.array([-0.5, -0.5, 1.0])
        beta = np.array([-1.0, 1.0, 0.0]) * (math.sqrt(3) / 2)
        along = math.cos(hue) * alpha + math.sin(hue) * beta
        across = (-math.sin(hue) * alpha + math.cos(hue) * beta) / math.tan(math.radians(self.half_angle_deg))
        return [(along - across).tolist(), (along + across).tolist()]

    def signal(self, image: Image) -> Signal:
        """Return the (h, w) signal [grey levels] of an (h, w, 3) BGR image; not clipped at 0."""
        return _core.signal(image, self.forms)


def hue_of(colour: NDArray[np.floating]) -> float:
    """Return the hue [deg, 0..360) of a (3,) BGR colour."""
    blue, green, red = (float(value) for value in colour)
    alpha = red - 0.5 * (green + blue)
    beta = math.sqrt(3) / 2 * (green - blue)
    return math.degrees(math.atan2(beta, alpha)) % 360.0
