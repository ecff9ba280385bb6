# SPDX-License-Identifier: Apache-2.0
"""Where the camera stands beside a finger, by what its calibration says of the finger's plane."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibration import FingerPlane, Lens

Array = NDArray[np.float64]


def camera_pose(lens: Lens, plane: FingerPlane) -> Array:
    """Return the pose (4, 4) of the optical frame (z forward, x right, y down) in the base frame of the plane's finger.

    The homography is the camera matrix times the first two axes of the base frame and its origin [m], all in the
    optical frame and up to one factor: Z. Zhang, A flexible new technique for camera calibration, 2000, section 3.1.
    """
    columns = np.linalg.solve(lens.matrix, plane.homography)
    columns *= math.copysign(1.0, columns[2, 2])  # the base is before the camera
    along, across, place = columns.T
    u, scales, v = np.linalg.svd(np.column_stack([along, across]), full_matrices=False)
    axes = u @ v  # the nearest two that are square and of length 1
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ place / scales.mean()
    return pose
