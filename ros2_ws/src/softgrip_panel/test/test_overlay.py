# SPDX-License-Identifier: Apache-2.0
"""The predicted finger in the camera's picture, through a lens without distortion that looks straight down."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.profile import load, shipped_directory
from softgrip_panel.model.overlay import ChainOverlay
from softgrip_vision.calibration import CameraCalibration, FingerPlane, Lens, save

PIXELS_PER_METRE, ORIGIN_PX = 5000.0, (100.0, 80.0)


@pytest.fixture
def overlay(tmp_path: Path) -> ChainOverlay:
    (u, v), scale = ORIGIN_PX, PIXELS_PER_METRE
    lens = Lens(800, 600, np.array([[900.0, 0.0, 400.0], [0.0, 900.0, 300.0], [0.0, 0.0, 1.0]]), np.zeros(5))
    plane = FingerPlane("index", np.array([[scale, 0.0, u], [0.0, -scale, v], [0.0, 0.0, 1.0]]), 0.020, 0.005, 0.1)
    path = tmp_path / "camera.yaml"
    save(CameraCalibration(lens, (plane,), "2026-11-25", "42", 0.1, 20), path)
    found = ChainOverlay("index", str(shipped_directory()), str(path))
    found.mount({"index": "power"})
    return found


def test_the_predicted_chain_ends_at_the_predicted_tip(overlay: ChainOverlay) -> None:
    tip_m = (0.0812, -0.0423)
    overlay.predict({"index": ((0.3, 0.2, 0.1), tip_m), "thumb": ((1.0,), (0.0, 0.0))})
    line = np.array(overlay.lines()["predicted"])
    length_m = load(shipped_directory() / "power.yaml").finger("index").link_lengths_m[0]
    in_plane = [(0.0, 0.0), (length_m * math.cos(0.3), -length_m * math.sin(0.3)), tip_m]
    expected = [(ORIGIN_PX[0] + PIXELS_PER_METRE * x, ORIGIN_PX[1] - PIXELS_PER_METRE * y) for x, y in in_plane]
    assert len(line) == 4
    assert line[[0, 1, 3]] == pytest.approx(np.array(expected), abs=1e-6)


@pytest.mark.parametrize("fingers", [{}, {"index": ((math.nan,) * 3, (math.nan, math.nan))}])
def test_what_was_not_predicted_is_not_drawn(overlay: ChainOverlay, fingers: dict) -> None:
    overlay.predict({"index": ((0.3, 0.2, 0.1), (0.08, -0.04))})
    overlay.predict(fingers)
    assert "predicted" not in overlay.lines()
