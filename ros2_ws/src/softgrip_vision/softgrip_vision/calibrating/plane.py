# SPDX-License-Identifier: Apache-2.0
"""Where a finger's plane lies in the image: the printed board laid into it, its cross on the first joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibrating.board import BoardView
from softgrip_vision.calibration import Lens
from softgrip_vision.errors import CalibrationError

Array = NDArray[np.float64]

MIN_CORNERS = 12
#: [px] RMS beyond which the board was not flat, or moved, or the lens is wrong.
LARGEST_RMS = 0.8


@dataclass(frozen=True)
class PlaneFit:
    """A fitted plane.

    Attributes:
        homography: (3, 3) metres in the finger's base frame to undistorted pixels.
        rms_px: [px] RMS of the corners.
        corners: number of corners used.
    """

    homography: Array
    rms_px: float
    corners: int


def to_plane(board_points: Array, origin_m: tuple[float, float]) -> Array:
    """Return (k, 2) board points [m] in the finger's base frame: x along the board's x, y up, 0 at the printed cross.

    Args:
        board_points: (k, 2) [m], y down.
        origin_m: [m] place of the cross in board coordinates.
    """
    return np.column_stack([board_points[:, 0] - origin_m[0], origin_m[1] - board_points[:, 1]])


def calibrate_plane(views: Sequence[BoardView], lens: Lens, origin_m: tuple[float, float]) -> PlaneFit:
    """Fit the homography of a finger's plane to views of the board at rest in it.

    Args:
        views: of the board, which does not move between them.
        lens: of the camera.
        origin_m: [m] place of the cross, which lies on the first joint, in board coordinates.

    Raises:
        CalibrationError: when the board was not seen, or does not lie still and flat.
    """
    corners = sum(len(view.points) for view in views)
    if corners < MIN_CORNERS:
        raise CalibrationError(
            f"expected the board in the finger's plane with at least {MIN_CORNERS} corners in sight, found "
            f"{corners} in {len(views)} views; check the board's size, light and focus"
        )
    wrong = {view.size for view in views} - {(lens.width, lens.height)}
    if wrong:
        raise CalibrationError(
            f"expected images of {lens.width}x{lens.height} as the lens was calibrated at, found {sorted(wrong)}"
        )
    points = to_plane(np.concatenate([view.points for view in views]), origin_m)
    pixels = lens.undistort(np.concatenate([view.pixels for view in views]))
    homography, _ = cv2.findHomography(points, pixels, 0)
    if homography is None:
        raise CalibrationError("expected corners that span a plane, found them on one line; show more of the board")
    mapped = np.asarray(cv2.perspectiveTransform(points.reshape(-1, 1, 2), homography)).reshape(-1, 2)
    rms = math.sqrt(float(np.mean(np.sum((mapped - pixels) ** 2, axis=1))))
    if rms > LARGEST_RMS:
        raise CalibrationError(
            f"expected the board flat and still, found a reprojection error of {rms:.2f} px (limit {LARGEST_RMS} px); "
            "press it flat, keep camera and board still, or calibrate the lens again"
        )
    return PlaneFit(np.asarray(homography, dtype=np.float64), rms, corners)
