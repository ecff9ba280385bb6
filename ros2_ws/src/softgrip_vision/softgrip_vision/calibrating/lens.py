# SPDX-License-Identifier: Apache-2.0
"""Lens calibration (Zhang's method, OpenCV), and whether the views were good enough for it."""

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

MIN_VIEWS = 8
#: [px] RMS of the whole set, and of one view, beyond which it is refused.
LARGEST_RMS = 0.6
#: A view this many times worse than the median view is named.
WORST_VIEW_FACTOR = 4.0
#: The image is divided into so many cells each way; corners must lie in at least this share of them.
CELLS = 4
MIN_COVERAGE = 0.75
#: [deg] of tilt that some views must reach in each of the directions; and the directions.
MIN_TILT_DEG = 12.0
#: One standard deviation of the focal length, relative.
LARGEST_FOCAL_STDDEV = 2e-3


@dataclass(frozen=True)
class LensFit:
    """A fitted lens.

    Attributes:
        lens: the lens.
        rms_px: [px] RMS reprojection error.
        view_rms_px: (views,) [px] RMS of each view.
        focal_stddev: (2,) [px] one standard deviation of fx, fy.
    """

    lens: Lens
    rms_px: float
    view_rms_px: Array
    focal_stddev: Array


def calibrate_lens(views: Sequence[BoardView], name: str = "camera") -> LensFit:
    """Fit a lens to views of a board.

    Raises:
        CalibrationError: when the set is too poor; the message lists every view to add or to take again.
    """
    problems = _count_problems(views)
    if problems:
        raise CalibrationError("; ".join(problems))
    size = views[0].size
    boards = [np.column_stack([view.points, np.zeros(len(view.points))]).astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    start = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1]], dtype=np.float64)
    rms, matrix, distortion, turns, _, deviations, _, view_rms = cv2.calibrateCameraExtended(
        boards, pixels, size, start, np.zeros(5), flags=cv2.CALIB_USE_INTRINSIC_GUESS
    )
    lens = Lens(size[0], size[1], np.asarray(matrix), np.asarray(distortion).ravel(), name)
    fit = LensFit(lens, float(rms), np.asarray(view_rms).ravel(), np.asarray(deviations).ravel()[:2])
    problems = [*_coverage_problems(views), *_tilt_problems(turns), *_fit_problems(fit, views)]
    if problems:
        raise CalibrationError("the views do not calibrate this lens: " + "; ".join(problems))
    return fit


def _count_problems(views: Sequence[BoardView]) -> list[str]:
    if len(views) < MIN_VIEWS:
        return [f"expected at least {MIN_VIEWS} different views of the whole board, found {len(views)}: add views"]
    sizes = {view.size for view in views}
    return [f"expected views of one resolution, found {sorted(sizes)}"] if len(sizes) > 1 else []


def covered_cells(views: Sequence[BoardView]) -> NDArray[np.bool_]:
    """Return (`CELLS`, `CELLS`) cells of the image in which some view shows a corner."""
    covered = np.zeros((CELLS, CELLS), dtype=bool)
    for view in views:
        places = np.clip((view.pixels / view.size * CELLS).astype(int), 0, CELLS - 1)
        covered[places[:, 1], places[:, 0]] = True
    return covered


def _coverage_problems(views: Sequence[BoardView]) -> list[str]:
    """Name the parts of the image where no view shows a corner."""
    covered = covered_cells(views)
    if covered.mean() >= MIN_COVERAGE:
        return []
    half = CELLS // 2
    quarters = {
        "top left": covered[:half, :half],
        "top right": covered[:half, half:],
        "bottom left": covered[half:, :half],
        "bottom right": covered[half:, half:],
    }
    empty = [name for name, cells in quarters.items() if cells.mean() < MIN_COVERAGE]
    found = f"corners cover {covered.mean():.0%} of the image, expected {MIN_COVERAGE:.0%}"
    return [f"{found}: add views with the board in the {', '.join(empty)}"]


def _tilt_problems(turns: Sequence[Array]) -> list[str]:
    """Name the directions in which no view tilts the board."""
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilts = np.degrees(np.arcsin(np.clip(normals[:, :2] * np.sign(normals[:, 2:]), -1, 1)))
    requested = {
        "left or right": float(np.abs(tilts[:, 0]).max()),
        "up or down": float(np.abs(tilts[:, 1]).max()),
    }
    return [
        f"the board leans {direction} by {maximum:.0f} deg at most, expected {MIN_TILT_DEG:.0f}: add views with it "
        f"tilted {direction} by 20 to 40 deg"
        for direction, maximum in requested.items()
        if maximum < MIN_TILT_DEG
    ]


def _fit_problems(fit: LensFit, views: Sequence[BoardView]) -> list[str]:
    problems = []
    if fit.rms_px > LARGEST_RMS or not math.isfinite(fit.rms_px):
        problems.append(f"reprojection error {fit.rms_px:.2f} px, expected below {LARGEST_RMS} px")
    limit = max(WORST_VIEW_FACTOR * float(np.median(fit.view_rms_px)), LARGEST_RMS)
    worst = [
        f"{view.name} ({error:.2f} px)" for view, error in zip(views, fit.view_rms_px, strict=True) if error > limit
    ]
    if worst:
        problems.append(f"take again, sharp and with the board flat: {', '.join(worst)}")
    relative = float((fit.focal_stddev / fit.lens.matrix[(0, 1), (0, 1)]).max())
    if not relative < LARGEST_FOCAL_STDDEV:
        problems.append(
            f"focal length known to {relative:.2%}, expected {LARGEST_FOCAL_STDDEV:.2%}: add views with the board "
            "tilted, and closer so that it fills the image"
        )
    return problems
