# SPDX-License-Identifier: Apache-2.0
"""Eq 4.5 in the mesh: its slopes are those of differences, and a few steps along them bring the closing nearer."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import OptimizeResult

from softgrip_design import mesh_objective
from softgrip_design.commands import optimise
from softgrip_design.mesh_objective import FollowOnMesh
from softgrip_design.objective import Weights
from softgrip_design.target import DesignTarget
from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe import GdfeError
from softgrip_model.gdfe.closing import ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.profile import load_directory, shipped_directory

DEFLECTIONS = np.radians([20.0, 40.0])


def follow(travel_mm: float = 12.0, deflections: np.ndarray = DEFLECTIONS) -> tuple[FollowOnMesh, np.ndarray]:
    """Return the aim to close by the middle joint most, and the published pinch finger's design vector."""
    profile = load_directory(shipped_directory())["pinch"]
    finger = Finger.from_profile(profile, "index")
    x = np.array([*finger.thickness_mm, *finger.routing_mm])
    target = DesignTarget(deflections, deflections[:, None] * np.array([0.3, 0.5, 0.2]))
    settings = ClosingSettings(RESOLUTIONS["coarse"], travel_mm=travel_mm, max_iterations=1000)
    friction = assumed_friction(profile).law
    return FollowOnMesh(finger, friction, target, Weights(2.0, 1.0), 0.8 * x, 1.2 * x, settings), x


def test_slopes_are_those_of_differences() -> None:
    objective, x = follow()
    closing = objective.closing(x)
    assert closing.angle_rad.sum(axis=1) == pytest.approx(DEFLECTIONS, abs=1e-8)
    value, slopes = objective.value_and_gradient(x)
    expected = 2.0 * objective.error_deg(x) + closing.tension_n[-1]
    assert value == pytest.approx(expected)
    for variable in (1, 4):
        step = 2e-4 * np.eye(len(x))[variable]
        difference = (objective.value(x + step) - objective.value(x - step)) / 4e-4
        assert slopes[variable] == pytest.approx(difference, rel=1e-4, abs=1e-4)


def test_a_few_steps_improve_it_and_none_makes_it_worse() -> None:
    objective, x = follow()
    moved = objective.improve(x, iterations=2)
    assert objective.value(moved) < objective.value(x) - 0.5
    assert (objective.lower <= moved).all()
    assert (moved <= objective.upper).all()


def test_a_search_that_ends_worse_gives_the_design_back(monkeypatch: pytest.MonkeyPatch) -> None:
    objective, x = follow()
    monkeypatch.setattr(mesh_objective, "minimize", lambda *_, **__: OptimizeResult(x=1.1 * x, fun=1e9))
    assert objective.improve(x) is x


def test_what_does_not_close_so_far_is_said() -> None:
    objective, x = follow(travel_mm=3.0)
    with pytest.raises(GdfeError, match=r"found none beyond 3\.00 mm"):
        objective.closing(x)
    assert objective.value(x) == math.inf


def test_the_command_tells_both_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(mesh_objective, "STEPS", 1)
    arguments = ["hand_pinch", "--finger", "index", "--starts", "1", "--on-mesh", "coarse", "--out", str(tmp_path)]
    assert optimise.main(arguments) == 0
    index = json.loads((tmp_path / "hand_pinch.json").read_text())["fingers"]["index"]
    before, after = index["mesh_error_deg"]
    assert after != before
    assert f"index {after:.2f} deg (the kernel's design {before:.2f} deg)" in capsys.readouterr().out.replace("\n", " ")
