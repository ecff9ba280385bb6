# SPDX-License-Identifier: Apache-2.0
"""A renderer of marker chains with known truth, for this package's tests and benchmarks. No node uses it.

Discs are drawn by supersampled coverage around their exact projected centres, then the picture goes through shadow,
blur, noise and JPEG in that order, as light does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import Calibration, FingerPlane, Lens, PlaneMap
from softgrip_vision.chain import ChainGeometry
from softgrip_vision.colour import Image
from softgrip_vision.layout import ChainLayout

Array = NDArray[np.float64]

MARKER_GREEN = (60.0, 190.0, 50.0)  # BGR
FINGER_GREY = (205.0, 200.0, 195.0)
BACKGROUND = (70.0, 66.0, 64.0)
SUPERSAMPLING = 6


def make_calibration(
    fingers: tuple[str, ...] = ("index",),
    *,
    width: int = 1280,
    height: int = 720,
    scale: float = 4500.0,
    tilt: float = 0.06,
    distortion: tuple[float, ...] = (-0.12, 0.05, 5e-4, -3e-4, 0.0),
) -> Calibration:
    """Return a calibration of a slightly tilted camera with a real lens.

    Args:
        fingers: each gets its own base place, side by side.
        width, height: [px].
        scale: [px/m] in the plane, about.
        tilt: [rad] of the camera.
        distortion: OpenCV coefficients.
    """
    focal = 0.9 * width
    matrix = np.array([[focal, 0.0, width / 2 + 3.7], [0.0, focal, height / 2 - 5.2], [0.0, 0.0, 1.0]])
    distance = focal / scale
    planes = []
    for index, finger in enumerate(fingers):
        rotation, _ = cv2.Rodrigues(np.array([math.pi + tilt, 0.5 * tilt, 0.02]))
        offset = (index - (len(fingers) - 1) / 2) * 0.42 * height / scale
        place = np.array([-0.22 * width / scale, -0.18 * height / scale + offset, distance])
        homography = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], place])
        planes.append(FingerPlane(finger, homography / homography[2, 2], 0.020, 0.005, 0.0))
    lens = Lens(width, height, matrix, np.array(distortion), "synthetic")
    return Calibration(lens, tuple(planes), "2026-11-21T00:00:00Z", "synthetic", 0.0, 1)


@dataclass(frozen=True)
class Conditions:
    """What happens to the picture.

    Attributes:
        noise: [grey levels] standard deviation per channel.
        blur: [px] standard deviation of defocus.
        motion_px: [px] length of motion blur along the row.
        exposure: gain; above 1 saturates.
        hue_shift: (3,) BGR gains of a wrong white balance.
        shadow: 0..1 darkness of a soft-edged shadow across the finger.
        jpeg: quality, 0 = none.
    """

    noise: float = 0.0
    blur: float = 0.6
    motion_px: float = 0.0
    exposure: float = 1.0
    hue_shift: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shadow: float = 0.0
    jpeg: int = 0


class Scene:
    """Renders one camera's view of its fingers.

    Args:
        calibration: of the camera (make_calibration).
        chains: finger name to chain.
        clutter: number of green things that are no markers.
        seed: of background and clutter.
    """

    def __init__(
        self, calibration: Calibration, chains: dict[str, ChainLayout], *, clutter: int = 0, seed: int = 0
    ) -> None:
        self.calibration = calibration
        self._planes = {name: calibration.plane(name) for name in chains}
        self._maps = {name: PlaneMap(calibration.lens, plane) for name, plane in self._planes.items()}
        self._geometry = {name: ChainGeometry(chains[name], self._planes[name].base_marker_m) for name in chains}
        self._random = np.random.default_rng(seed)
        self._background = self._paint_background(clutter)

    def _paint_background(self, clutter: int) -> NDArray[np.float32]:
        lens = self.calibration.lens
        coarse = self._random.normal(0.0, 6.0, (9, 16, 1)) + self._random.normal(0.0, 2.0, (9, 16, 3))
        image = cv2.resize(coarse.astype(np.float32), (lens.width, lens.height), interpolation=cv2.INTER_CUBIC)
        image += np.array(BACKGROUND, dtype=np.float32)
        for _ in range(clutter):
            colour = np.array(MARKER_GREEN) * self._random.uniform(0.5, 1.2, 3)
            centre = tuple(int(x) for x in self._random.uniform((0, 0), (lens.width, lens.height)))
            axes = tuple(int(x) for x in self._random.uniform(4, 60, 2))
            cv2.ellipse(image, centre, axes, float(self._random.uniform(0, 180)), 0, 360, colour.tolist(), -1)
        return np.asarray(image, dtype=np.float32)

    def markers(self, finger: str, angles: Array) -> tuple[Array, Array]:
        """Return the true (n + 2, 2) places [m] in the plane, and (n + 2, 2) projected centres [px]."""
        geometry = self._geometry[finger]
        state = np.zeros(3 + 2 * geometry.layout.joints)
        state[3 : 3 + geometry.layout.joints] = angles
        points = geometry.markers(state)
        return points, self._maps[finger].to_pixels(points)

    def render(
        self,
        angles: dict[str, Array],
        conditions: Conditions | None = None,
        *,
        hidden: dict[str, set[int]] | None = None,
    ) -> Image:
        """Return the (h, w, 3) BGR frame of fingers at the given joint angles [rad].

        Args:
            angles: finger name to (n,) joint angles.
            conditions: of light and camera.
            hidden: finger name to the numbers of markers behind a grey occluder.
        """
        conditions = conditions or Conditions()
        image = self._background.copy()
        for finger, pose in angles.items():
            points, pixels = self.markers(finger, pose)
            self._paint_links(image, pixels)
            for index, (point, pixel) in enumerate(zip(points, pixels, strict=True)):
                self._paint_disc(image, finger, point, pixel)
                if index in (hidden or {}).get(finger, set()):
                    centre = (round(float(pixel[0])), round(float(pixel[1])))
                    cv2.circle(image, centre, 22, (120.0, 140.0, 175.0), -1, cv2.LINE_AA)
        return self._through_camera(image, conditions)

    def _paint_links(self, image: NDArray[np.float32], pixels: Array) -> None:
        for start, end in zip(pixels[:-1], pixels[1:], strict=True):
            first, second = (tuple(int(x) for x in np.rint(p * 16)) for p in (start, end))
            cv2.line(image, first, second, FINGER_GREY, 44, cv2.LINE_AA, 4)

    def _paint_disc(self, image: NDArray[np.float32], finger: str, point: Array, pixel: Array) -> None:
        radius = self._planes[finger].marker_diameter_m / 2
        _, (jacobian,) = self._maps[finger].to_plane_with_jacobian(pixel[None, :])
        reach = math.ceil(radius / math.sqrt(abs(np.linalg.det(jacobian))) * 1.3) + 2
        left, top = int(pixel[0]) - reach, int(pixel[1]) - reach
        if left < 0 or top < 0 or left + 2 * reach >= image.shape[1] or top + 2 * reach >= image.shape[0]:
            return
        size = 2 * reach + 1
        fine = (np.arange(size * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
        du, dv = np.meshgrid(left + fine - pixel[0], top + fine - pixel[1])
        x = jacobian[0, 0] * du + jacobian[0, 1] * dv
        y = jacobian[1, 0] * du + jacobian[1, 1] * dv
        inside = (x**2 + y**2 <= radius**2).astype(np.float32)
        cover = inside.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING).mean(axis=(1, 3))[:, :, None]
        part = image[top : top + size, left : left + size]
        part += cover * (np.array(MARKER_GREEN, dtype=np.float32) - part)

    def _through_camera(self, image: NDArray[np.float32], conditions: Conditions) -> Image:
        if conditions.shadow:
            columns = np.arange(image.shape[1], dtype=np.float32)
            edge = 1.0 / (1.0 + np.exp(-(columns - 0.55 * image.shape[1]) / 4.0))
            image = image * (1.0 - conditions.shadow * edge)[None, :, None]
        if conditions.blur:
            image = cv2.GaussianBlur(image, (0, 0), conditions.blur)
        if conditions.motion_px >= 1.0:
            length = round(conditions.motion_px)
            image = cv2.blur(image, (length | 1, 1))
        image = image * (conditions.exposure * np.array(conditions.hue_shift, dtype=np.float32))
        if conditions.noise:
            image = image + self._random.standard_normal(image.shape, dtype=np.float32) * conditions.noise
        frame = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        if conditions.jpeg:
            _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, conditions.jpeg])
            frame = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
        return frame
