# SPDX-License-Identifier: Apache-2.0
"""From views of a printed board to a calibration file."""

from softgrip_vision.calibrating.board import Board, BoardView, has_charuco
from softgrip_vision.calibrating.lens import LensFit, calibrate_lens, covered_cells
from softgrip_vision.calibrating.plane import PlaneFit, calibrate_plane
from softgrip_vision.calibrating.views import MAX_VIEWS, collect_views, is_new_view

__all__ = [
    "MAX_VIEWS",
    "Board",
    "BoardView",
    "LensFit",
    "PlaneFit",
    "calibrate_lens",
    "calibrate_plane",
    "collect_views",
    "covered_cells",
    "has_charuco",
    "is_new_view",
]
