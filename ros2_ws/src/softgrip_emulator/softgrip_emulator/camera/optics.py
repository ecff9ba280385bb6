# SPDX-License-Identifier: Apache-2.0
"""The emulated camera's true optics, and the slightly wrong calibration that somebody made of them.

The calibration file has the layout of ROS camera_info YAML plus a key `softgrip` with the homography of each finger's
plane: (x, y, 1) [m] in the finger's base frame to undistorted pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import yaml

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BASE_MARKER_M: Final = 0.020
"""The base marker sits this far behind the first joint."""
MARKER_DIAMETER_M: Final = 0.005
_PIXELS_PER_METRE_AT_480: Final = 3600.0
_BASE_AT: Final = (0.30, 0.17)
"""Where the first joint stands in the picture, as shares of width and height."""


@dataclass(frozen=True)
class Optics:
    """A pinhole with lens distortion that looks at one finger's plane.

    Attributes:
        width, height: [px].
        matrix: (3, 3) camera matrix [px].
        distortion: (5,) OpenCV k1, k2, p1, p2, k3.
        homography: (3, 3) plane [m] to undistorted pixels.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    homography: Array

    def in_plane(self, points: Array) -> Array:
        """(n, 2) places in the finger's plane that points (n, 3) beside it are seen at [m]."""
        centre = self.centre_m
        share = centre[2] / (centre[2] - points[:, 2])
        return np.asarray(centre[:2] + share[:, None] * (points[:, :2] - centre[:2]))

    @property
    def centre_m(self) -> Array:
        """(3,) where the camera is, in the finger's base frame; the third coordinate towards it [m]."""
        columns = np.linalg.solve(self.matrix, self.homography)
        columns = columns / np.linalg.norm(columns[:, 0])
        columns = columns * np.sign(columns[2, 2])
        along, across, place = columns.T
        rotation = np.column_stack([along, across, np.cross(along, across)])
        centre = -rotation.T @ place
        return np.asarray(centre * [1.0, 1.0, np.sign(centre[2])])

    def to_pixels(self, points: Array) -> Array:
        """(n, 2) pixels of (n, 2) plane points [m]; pixel (0, 0) is the centre of the top left pixel."""
        mapped = points @ self.homography[:, :2].T + self.homography[:, 2]
        rays = np.ones((len(points), 3))
        rays[:, :2] = (mapped[:, :2] / mapped[:, 2:] - self.matrix[:2, 2]) / self.matrix[(0, 1), (0, 1)]
        x, y = rays[:, 0], rays[:, 1]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent = np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=1,
        )
        return np.asarray(bent * self.matrix[(0, 1), (0, 1)] + self.matrix[:2, 2])


def draw_optics(width: int, height: int, seed: int) -> Optics:
    """The true camera for a seed: a little tilted, with a small barrel distortion."""
    rng = np.random.default_rng([seed, 0x4341])
    focal = 1.25 * width * rng.uniform(0.98, 1.02)
    centre = np.array([width / 2.0, height / 2.0]) + rng.normal(0.0, 0.004 * width, 2)
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    distance = focal / (_PIXELS_PER_METRE_AT_480 * height / 480.0)
    # Half a turn about x: the finger closes towards -y, which is down in the picture, where v grows.
    rotation, _ = cv2.Rodrigues(np.array([math.pi, 0.0, 0.0]) + rng.normal(0.0, 0.03, 3))
    base_px = np.array([_BASE_AT[0] * width, _BASE_AT[1] * height])
    place = np.append((base_px - centre) * distance / focal, distance)
    homography = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], place])
    distortion = np.array([rng.uniform(-0.12, -0.06), rng.uniform(0.01, 0.04), *rng.normal(0.0, 3e-4, 2), 0.0])
    return Optics(width, height, matrix, distortion, homography / homography[2, 2])


def calibrated(true: Optics, seed: int) -> Optics:
    """What a careful person measured of `true`: focal length to 0.1 %, centre to a pixel, plane to 0.2 mm."""
    rng = np.random.default_rng([seed, 0x4343])
    matrix = true.matrix.copy()
    matrix[(0, 1), (0, 1)] *= 1.0 + rng.normal(0.0, 0.001)
    matrix[:2, 2] += rng.normal(0.0, 1.0, 2) * true.width / 640.0
    distortion = true.distortion * (1.0 + rng.normal(0.0, 0.03, 5))
    believed = replace(true, matrix=matrix, distortion=distortion)
    # The plane was found with a printed target whose corners were off a little and were seen through the true lens.
    corners = np.array([[x, y] for x in (-0.02, 0.03, 0.08) for y in (-0.08, -0.04, 0.005)])
    seen = true.to_pixels(corners + rng.normal(0.0, 0.15e-3, corners.shape)) + rng.normal(0.0, 0.1, corners.shape)
    undistorted = cv2.undistortPoints(seen.reshape(-1, 1, 2), matrix, distortion, P=matrix).reshape(-1, 2)
    homography, _ = cv2.findHomography(corners, undistorted)
    return replace(believed, homography=np.asarray(homography))


def write_calibration(path: Path, optics: Optics, finger: str, seed: int) -> None:
    """Write the calibration file in one step, so that no reader sees half of it."""
    projection = np.hstack([optics.matrix, np.zeros((3, 1))])
    document = {
        "image_width": optics.width,
        "image_height": optics.height,
        "camera_name": "cell_camera",
        "camera_matrix": _entry(optics.matrix),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _entry(optics.distortion[None, :]),
        "rectification_matrix": _entry(np.eye(3)),
        "projection_matrix": _entry(projection),
        "softgrip": {
            "schema": 1,
            "date": "2026-11-01T09:00:00Z",
            "camera_serial": f"EMULATED-{seed}",
            "reprojection_error_px": 0.12,
            "views": 18,
            "planes": [
                {
                    "finger": finger,
                    "homography": _entry(optics.homography),
                    "base_marker_m": BASE_MARKER_M,
                    "marker_diameter_m": MARKER_DIAMETER_M,
                    "reprojection_error_px": 0.25,
                }
            ],
        },
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".{path.name}.part")
    scratch.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    scratch.replace(path)


def _entry(matrix: Array) -> dict[str, object]:
    rows, cols = matrix.shape
    return {"rows": rows, "cols": cols, "data": [float(value) for value in matrix.ravel()]}
