# SPDX-License-Identifier: Apache-2.0
"""What the cell tells its camera: how to be, and at each exposure what there is to see."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraSettings:
    """Resolution and rate of the emulated camera; port 0 = a free one.

    `realtime_priority` (SCHED_FIFO, sched(7); 0 = none) is taken where it is allowed.
    """

    width: int = 640
    height: int = 480
    fps: float = 30.0
    port: int = 0
    jpeg_quality: int = 88
    realtime_priority: int = 0


@dataclass(frozen=True)
class ExposureReport:
    """What the camera reports after each exposure, and when the number of viewers changes.

    Attributes:
        frames_taken: since the start.
        viewers: of the stream.
        is_rendered: an exposure has ended; False where only the viewers changed.
        is_shown: its frame went to the stream: the sensor did not lose it.
    """

    frames_taken: int
    viewers: int
    is_rendered: bool = False
    is_shown: bool = False


@dataclass(frozen=True)
class SetUp:
    """What a camera begins with.

    Attributes:
        settings: resolution, rate, port.
        seed: of the true optics, of what somebody calibrated of them, and of every picture.
        finger: that the calibration is for.
        url_file, calibration_file: are written.
    """

    settings: CameraSettings
    seed: int
    finger: str
    url_file: Path
    calibration_file: Path


@dataclass
class CameraFaults:
    """What goes wrong with the camera, or with what it looks at; neutral by default.

    Attributes:
        frozen: it repeats a frame.
        drop_share: of the frames that the sensor loses.
        gain: of the light.
        blur_px: standard deviation of a Gaussian that a lens out of focus adds.
        missing_marker: that fell off, 0 = at the base; -1 = none.
    """

    frozen: bool = False
    drop_share: float = 0.0
    gain: float = 1.0
    blur_px: float = 0.0
    missing_marker: int = -1


@dataclass(frozen=True)
class Pose:
    """The finger as the camera sees it at one instant.

    Attributes:
        joints_m: (n + 1, 2) where in the finger's plane joints and tip are seen, in its base frame [m].
        headings_rad: (n,) direction of each link [rad], 0 = straight, growing as it closes.
        body_height_m: depth of the body on the closing side.
        product_m: (m, 2) outline of what is behind the finger; m = 0 for nothing.
    """

    joints_m: Array
    headings_rad: Array
    body_height_m: float = 0.012
    product_m: Array = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True)
class ExposureSample:
    """What there is to see in one exposure.

    Attributes:
        pose: of the finger at the end of the exposure.
        before: at its beginning.
        stamp_s: seconds since the epoch.
        faults: of the camera.
    """

    pose: Pose
    before: Pose
    stamp_s: float
    faults: CameraFaults = field(default_factory=CameraFaults)
