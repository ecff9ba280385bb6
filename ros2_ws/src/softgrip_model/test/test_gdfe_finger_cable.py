# SPDX-License-Identifier: Apache-2.0
"""The cable of a finger's mesh against one that is worked out here, and its strips against CalculiX."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe.cable import CableDrive
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings, solve_closing
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.materials import ninjaflex_ogden
from softgrip_model.gdfe.solver import ConstitutiveLaw, State
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.calculix_cable import calculix_closings, closing_of, our_closing
from softgrip_testing.calculix_finger import calculix_moments, our_moments, reference_closing
from softgrip_testing.scripts import load_script


@pytest.fixture(scope="module")
def closing():
    settings = ClosingSettings(RESOLUTIONS["coarse"], 6.0, keyframe_mm=2.0, tolerance=1e-6, max_iterations=4000)
    return ClosingPath(load_directory(shipped_directory())["power"], "index", settings)


def cable_points(finger, displacement):
    """Return the cable's points at a state, (k, 3) [mm]."""
    at = finger.mesh.nodes + displacement
    return np.array([p.weights @ at[p.nodes] if len(p.nodes) else np.array(p.position) for p in finger.routing])


def cable_forces(finger, law, displacement, tension):
    """Return forces on the nodes (n, 3) of a cable pulled by a tension, Eqs 3.7-3.9."""
    points = cable_points(finger, displacement)
    spans = np.vstack([[1.0, 0.0, 0.0], np.diff(points, axis=0)])  # the first one runs to the actuator, along -x
    directions = spans / np.linalg.norm(spans, axis=1)[:, None]
    angles = np.arccos(np.clip((directions[:-1] * directions[1:]).sum(axis=1), -1.0, 1.0))
    tensions = [tension]
    for angle in angles:  # T_before = Rf(angle, T_after) T_after
        low = tensions[-1]
        for _ in range(100):
            low = tensions[-1] / float(law.ratio(angle, max(low, 1e-2)))
        tensions.append(low)
    load = np.zeros_like(finger.mesh.nodes)
    for number, point in enumerate(finger.routing):
        force = -tensions[number] * directions[number]
        if number + 1 < len(directions):
            force = force + tensions[number + 1] * directions[number + 1]
        load[point.nodes] += point.weights[:, None] * force
    return load


@pytest.mark.parametrize("pull_mm", [2.0, 5.0])
def test_the_mesh_is_in_balance_with_its_cable(closing, pull_mm):
    finger = closing.finger_mesh
    shape = closing.shape(1e-3 * pull_mm)
    displacement = 1e3 * shape.vertices - finger.mesh.nodes
    load = cable_forces(finger, closing.friction.law, displacement, shape.tension[0])
    inside = closing.body.solver.internal_force(displacement)
    free = np.setdiff1d(np.arange(len(load)), finger.clamped)
    assert shape.converged
    assert np.abs(load).max() > 0.01
    np.testing.assert_allclose(inside[free], load[free], atol=2e-3 * np.abs(load).max())


def test_the_cable_is_shorter_by_what_was_pulled(closing):
    finger = closing.finger_mesh
    displacement = 1e3 * closing.shape(0.005).vertices - finger.mesh.nodes

    def length(moved):
        return np.linalg.norm(np.diff(cable_points(finger, moved), axis=0), axis=1).sum()

    assert length(0.0 * displacement) - length(displacement) == pytest.approx(5.0, abs=2e-3)


@pytest.mark.slow
def test_by_the_rigorous_law_one_long_pull_needs_few_iterations():
    """Nearly incompressible (nu 0.49), one millimetre at once: without the tangent 13,746 iterations (pinch)."""
    profile = load_directory(shipped_directory())["pinch"]
    body = Body(profile, "index", RESOLUTIONS["coarse"], material=ninjaflex_ogden(0.49), law=ConstitutiveLaw.RIGOROUS)
    settings = ClosingSettings(RESOLUTIONS["coarse"], 2.0, tolerance=1e-6, max_iterations=1500)
    friction = assumed_friction(profile)
    state = State(np.zeros_like(body.finger_mesh.mesh.nodes), (0.0,))
    for pulled_mm in (1.0, 2.0):
        found = solve_closing(settings, friction, body.solver, pulled_mm, state)
        assert found.converged
        state = found.state
    load = cable_forces(body.finger_mesh, friction.law, found.displacement, found.tension[0][0])
    free = ~body.solver.supports.prescribed[:, 0]
    out_of_balance = (load - body.solver.internal_force(found.displacement))[free]
    assert np.linalg.norm(out_of_balance) < 1e-5 * np.linalg.norm(found.reaction)


def test_strips_bend_as_in_calculix():
    # CalculiX' C3D8I is softer in bending than three of our hexahedra through a strip; docs/gdfe.md has the figures
    reference, ours = calculix_moments()[4.0], our_moments(reference_closing(4.0), 4.0)
    assert (np.abs(reference) > 1.0).all()
    np.testing.assert_allclose(ours, reference, rtol=0.10)


def difference_to_calculix(ours, theirs):
    """Return the distance of the tips [mm], of the joints [rad], and the ratio of the tensions."""
    joints = np.abs(ours.joint_rad - theirs.joint_rad).max()
    return np.linalg.norm(ours.tip_mm - theirs.tip_mm), joints, ours.tension_n / theirs.tension_n


@pytest.mark.parametrize("design", ["hook", "pinch", "power"])
def test_a_finger_closes_as_in_calculix(design):
    """Whole fingers of 95 mm with C3D8, like our elements not relaxed in bending; docs/gdfe.md has the figures."""
    closing = closing_of(design)
    for pulled_mm in (4.0, 8.0):
        theirs = calculix_closings()[design, "C3D8", pulled_mm]
        tip, joints, tensions = difference_to_calculix(our_closing(closing, pulled_mm), theirs)
        assert np.abs(theirs.joint_rad).max() > 0.2
        assert tip < 0.25 * pulled_mm
        assert joints < 0.05
        assert tensions == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_the_reference_is_what_calculix_gives():
    path = Path(__file__).resolve().parents[4] / "tools" / "docs" / "gdfe_cable_calculix.py"
    maker = load_script(path)
    closing = closing_of("pinch")
    shape = closing.shape(0.004)
    text = maker.deck(closing.finger_mesh, np.array(shape.tension[1:]), "C3D8")
    increments = maker.calculix(text, len(closing.finger_mesh.mesh.nodes))
    found = maker.at_length(closing.finger_mesh, increments, 4.0, maker.FULL_SHARE * shape.tension[0])
    kept = calculix_closings()["pinch", "C3D8", 4.0]
    np.testing.assert_allclose(found.tip_mm, kept.tip_mm, atol=0.02)
    np.testing.assert_allclose(found.joint_rad, kept.joint_rad, atol=1e-3)
    assert found.tension_n == pytest.approx(kept.tension_n, rel=2e-3)


def test_a_start_without_the_cables_tension_is_refused(closing):
    solver, rest = closing.body.solver, np.zeros_like(closing.finger_mesh.mesh.nodes)
    for start in (State(rest), State(rest[1:], (0.0,))):
        with pytest.raises(GdfeError, match=r"start: expected displacements .* and 1 anchor tensions, found"):
            solver.solve(start=start, drives=[CableDrive(1.0)])
