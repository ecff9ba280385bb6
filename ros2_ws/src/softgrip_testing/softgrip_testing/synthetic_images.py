# SPDX-License-Identifier: Apache-2.0
"""A renderer of marker chains with known truth, for this package's tests and benchmarks. No node uses it.

Discs are drawn by supersampled coverage around their exactly projected centres; then the picture goes through shadow,
blur, exposure, noise and JPEG in that order, as light does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import CameraCalibration, FingerPlane, Lens, PlaneMap
from softgrip_vision.chain import ChainGeometry
from softgrip_vision.colour import Image
from softgrip_vision.layout import ChainLayout

Array = NDArray[np.float64]
Canvas = NDArray[np.float32]

MARKER_GREEN = (60.0, 190.0, 50.0)  # BGR
FINGER_GREY = (205.0, 200.0, 195.0)
BACKGROUND = (70.0, 66.0, 64.0)
LINK_WIDTH_PX = 44
SUPERSAMPLING = 6
#: Fixed-point bits of OpenCV's drawing coordinates.
SHIFT = 4


def make_calibration(
    fingers: tuple[str, ...] = ("index",),
    *,
    width: int = 1280,
    height: int = 720,
    scale: float = 4500.0,
    tilt: float = 0.06,
    distortion: tuple[float, ...] = (-0.12, 0.05, 5e-4, -3e-4, 0.0),
) -> CameraCalibration:
    """Return a calibration of a slightly tilted camera with a real lens.

    Args:
        fingers: each gets its own base place, side by side.
        width: [px] of the image.
        height: [px] of the image.
        scale: [px/m] in the plane, about.
        tilt: [rad] of the camera.
        distortion: OpenCV coefficients.
    """
    focal = 0.9 * width
    matrix = np.array([[focal, 0.0, width / 2 + 3.7], [0.0, focal, height / 2 - 5.2], [0.0, 0.0, 1.0]])
    distance = focal / scale
    rotation, _ = cv2.Rodrigues(np.array([math.pi + tilt, 0.5 * tilt, 0.02]))
    planes = []
    for index, finger in enumerate(fingers):
        offset = (index - (len(fingers) - 1) / 2) * 0.3 * height / scale
        place = np.array([-0.22 * width / scale, -0.18 * height / scale + offset, distance])
        homography = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], place])
        planes.append(FingerPlane(finger, homography / homography[2, 2], 0.020, 0.005, 0.0))
    lens = Lens(width, height, matrix, np.array(distortion), "synthetic")
    return CameraCalibration(lens, tuple(planes), "2026-11-21T00:00:00Z", "synthetic", 0.0, 1)


@dataclass(frozen=True)
class Conditions:
    """What happens to the picture.

    Attributes:
        noise: [grey levels] standard deviation per channel.
        blur: [px] standard deviation of defocus.
        motion_px: [px] length of motion blur along the row.
        exposure: gain; above 1 saturates.
        channel_gains: (3,) BGR gains of a wrong white balance.
        shadow: 0..1 darkness of a soft-edged shadow right of ``shadow_edge``.
        shadow_edge: 0..1 of the image's width.
        jpeg: quality, 0 = none.
    """

    noise: float = 0.0
    blur: float = 0.6
    motion_px: float = 0.0
    exposure: float = 1.0
    channel_gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shadow: float = 0.0
    shadow_edge: float = 0.5
    jpeg: int = 0


@dataclass(frozen=True)
class Occluder:
    """A disc in front of everything.

    Attributes:
        u, v: [px] its centre.
        radius_px: [px].
        colour: BGR.
    """

    u: float
    v: float
    radius_px: float
    colour: tuple[float, float, float] = (120.0, 140.0, 175.0)


@dataclass
class Picture:
    """A frame with its truth.

    Attributes:
        image: (h, w, 3) BGR.
        centres: per finger (n + 2, 2) [px] projected centres of the markers.
        visible: per finger (n + 2,) 0..1 share of each marker's disc that is not covered.
    """

    image: Image
    centres: dict[str, Array] = field(default_factory=dict)
    visible: dict[str, Array] = field(default_factory=dict)


class SyntheticScene:
    """Renders one camera's view of its fingers.

    Args:
        calibration: of the camera (make_calibration).
        chains: finger name to chain.
        clutter: number of green things behind the fingers that are no markers.
        decoys: number of green discs of a marker's size behind the fingers.
        seed: of background, clutter and noise.
        body_offset_px: (2,) [px] of the bodies against their markers, which then sit on an edge.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        chains: Mapping[str, ChainLayout],
        *,
        clutter: int = 0,
        decoys: int = 0,
        seed: int = 0,
        body_offset_px: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.calibration = calibration
        self._body_offset = np.array(body_offset_px)
        self._planes = {name: calibration.plane(name) for name in chains}
        self._maps = {name: PlaneMap(calibration.lens, plane) for name, plane in self._planes.items()}
        self._geometry = {name: ChainGeometry(chains[name], self._planes[name].base_marker_m) for name in chains}
        self._random = np.random.default_rng(seed)
        self._background = self._paint_background(clutter, decoys)
        lens = calibration.lens
        self._noise = self._random.standard_normal((lens.height + 64, lens.width + 64, 3), dtype=np.float32)

    def _paint_background(self, clutter: int, decoys: int) -> Canvas:
        lens, random = self.calibration.lens, self._random
        coarse = random.normal(0.0, 6.0, (9, 16, 1)) + random.normal(0.0, 2.0, (9, 16, 3))
        image = cv2.resize(coarse.astype(np.float32), (lens.width, lens.height), interpolation=cv2.INTER_CUBIC)
        image += np.array(BACKGROUND, dtype=np.float32)
        sizes = [*random.uniform(4, 60, (clutter, 2)), *np.repeat(random.uniform(9, 13, (decoys, 1)), 2, axis=1)]
        for axes in sizes:
            colour = np.array(MARKER_GREEN) * random.uniform(0.6, 1.2) * random.uniform(0.85, 1.15, 3)
            centre = _fixed(random.uniform((0, 0), (lens.width, lens.height)))
            turn = float(random.uniform(0, 180))
            cv2.ellipse(image, centre, _fixed(axes), turn, 0, 360, colour.tolist(), -1, cv2.LINE_AA, SHIFT)
        return np.asarray(image, dtype=np.float32)

    def centres(self, finger: str, angles: Array) -> Array:
        """Return the true (n + 2, 2) projected centres [px] of a finger's markers at (n,) joint angles [rad]."""
        geometry = self._geometry[finger]
        state = np.zeros(3 + 2 * geometry.layout.joints)
        state[3 : 3 + geometry.layout.joints] = angles
        return self._maps[finger].to_pixels(geometry.markers(state))

    def to_plane(self, finger: str, pixels: Array) -> Array:
        """Return (n, 2) points [m] in a finger's plane of (n, 2) pixels."""
        return self._maps[finger].to_plane(pixels)

    def tip(self, finger: str, angles: Array) -> Array:
        """Return the true (2,) tip [m] at (n,) joint angles [rad]."""
        lengths = np.array(self._geometry[finger].layout.link_lengths_m)
        headings = -np.cumsum(angles)
        return np.array([lengths @ np.cos(headings), lengths @ np.sin(headings)])

    def render(
        self,
        angles: Mapping[str, Array],
        conditions: Conditions | None = None,
        occluders: Sequence[Occluder] = (),
    ) -> Picture:
        """Return the frame and truth of fingers at the given (n,) joint angles [rad], later fingers in front."""
        canvas = self._background.copy()
        owner = np.zeros(canvas.shape[:2], dtype=np.uint8)
        centres = {finger: self.centres(finger, pose) for finger, pose in angles.items()}
        painted: dict[tuple[str, int], int] = {}
        for finger, pixels in centres.items():
            for start, end in pairwise(pixels + self._body_offset):
                cv2.line(canvas, _fixed(start), _fixed(end), FINGER_GREY, LINK_WIDTH_PX, cv2.LINE_AA, SHIFT)
                cv2.line(owner, _fixed(start), _fixed(end), 0, LINK_WIDTH_PX, cv2.LINE_8, SHIFT)
            for index, pixel in enumerate(pixels):
                label = len(painted) + 1
                painted[finger, index] = self._paint_disc(canvas, owner, label, finger, pixel)
        for thing in occluders:
            at, radius = _fixed(np.array([thing.u, thing.v])), round(thing.radius_px * 2**SHIFT)
            cv2.circle(canvas, at, radius, thing.colour, -1, cv2.LINE_AA, SHIFT)
            cv2.circle(owner, at, radius, 0, -1, cv2.LINE_8, SHIFT)
        left = np.bincount(owner.ravel(), minlength=len(painted) + 1)
        shares = {key: left[label + 1] / max(1, size) for label, (key, size) in enumerate(painted.items())}
        visible = {name: np.array([shares[name, i] for i in range(len(px))]) for name, px in centres.items()}
        return Picture(self._through_camera(canvas, conditions or Conditions()), centres, visible)

    def _paint_disc(self, canvas: Canvas, owner: Image, label: int, finger: str, pixel: Array) -> int:
        """Paint one marker, note whose pixels these are, return how many."""
        radius = self._planes[finger].marker_diameter_m / 2
        _, (jacobian,) = self._maps[finger].to_plane_with_jacobian(pixel[None, :])
        reach = math.ceil(radius / math.sqrt(abs(np.linalg.det(jacobian))) * 1.3) + 2
        left, top = int(pixel[0]) - reach, int(pixel[1]) - reach
        size = 2 * reach + 1
        if left < 0 or top < 0 or left + size > canvas.shape[1] or top + size > canvas.shape[0]:
            return 0
        fine = (np.arange(size * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
        du, dv = np.meshgrid(left + fine - pixel[0], top + fine - pixel[1])
        x = jacobian[0, 0] * du + jacobian[0, 1] * dv
        y = jacobian[1, 0] * du + jacobian[1, 1] * dv
        inside = (x**2 + y**2 <= radius**2).astype(np.float32)
        cover = inside.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING).mean(axis=(1, 3))
        part = canvas[top : top + size, left : left + size]
        part += cover[:, :, None] * (np.array(MARKER_GREEN, dtype=np.float32) - part)
        owner[top : top + size, left : left + size][cover > 0.5] = label
        return int((cover > 0.5).sum())

    def _through_camera(self, canvas: Canvas, conditions: Conditions) -> Image:
        height, width = canvas.shape[:2]
        gains = conditions.exposure * np.array(conditions.channel_gains, dtype=np.float32)
        if conditions.shadow:
            columns = np.arange(width, dtype=np.float32)
            dark = 0.5 + 0.5 * np.tanh((columns - conditions.shadow_edge * width) / 8.0)
            canvas = canvas * (1.0 - conditions.shadow * dark)[None, :, None]
        if conditions.blur:
            canvas = np.asarray(cv2.GaussianBlur(canvas, (0, 0), conditions.blur), dtype=np.float32)
        if conditions.motion_px >= 2.0:
            canvas = np.asarray(cv2.blur(canvas, (round(conditions.motion_px) | 1, 1)), dtype=np.float32)
        canvas = canvas * gains
        if conditions.noise:
            row, column = self._random.integers(0, 64, 2)
            canvas = canvas + self._noise[row : row + height, column : column + width] * np.float32(conditions.noise)
        frame = np.clip(np.rint(canvas), 0, 255).astype(np.uint8)
        if conditions.jpeg:
            _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, conditions.jpeg])
            frame = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
        return frame


def _fixed(point: Array) -> tuple[int, int]:
    """Return an OpenCV fixed-point coordinate pair."""
    return round(float(point[0]) * 2**SHIFT), round(float(point[1]) * 2**SHIFT)
