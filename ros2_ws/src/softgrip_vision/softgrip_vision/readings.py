# SPDX-License-Identifier: Apache-2.0
"""What the tracker says about one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MarkerReading:
    """One marker in one frame.

    Attributes:
        name: "base", "joint_0", ..., "tip".
        pixel: (2,) [px] centre: measured, or expected from the chain when occluded; NaN when neither is known.
        point: (2,) [m] the same in the finger's plane (its base frame).
        stddev_px: [px] one standard deviation of the centre.
        confidence: 0..1 that this is the marker; 0 when occluded.
        occluded: not seen in this frame.
    """

    name: str
    pixel: Array
    point: Array
    stddev_px: float
    confidence: float
    occluded: bool


@dataclass(frozen=True)
class FingerPose:
    """Joint angles and tip, where the frame shows enough to know them.

    Attributes:
        angles: (n,) [rad] and angles_stddev: (n,) [rad].
        tip: (2,) [m] in the finger's base frame and tip_stddev: (2,) [m].
    """

    angles: Array
    angles_stddev: Array
    tip: Array
    tip_stddev: Array


@dataclass(frozen=True)
class FingerReading:
    """One finger in one frame.

    Attributes:
        finger, profile: names.
        markers: base to tip.
        threshold_quality: 0..1 how well the markers' colour stands out (see sightings.threshold_quality).
        pose: None when the frame does not show enough to know it.
        problem: why there is no pose, in words; empty when there is one.
    """

    finger: str
    profile: str
    markers: tuple[MarkerReading, ...]
    threshold_quality: float
    pose: FingerPose | None
    problem: str = ""
