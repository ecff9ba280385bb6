# SPDX-License-Identifier: Apache-2.0
"""Gradients of the mesh's shape: against central differences of whole solves, and of one spring's closed form."""

from dataclasses import replace

import numpy as np
import pytest

from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe import CableDrive, GdfeError, Solver, SolverSettings, Supports, _core, bar
from softgrip_model.gdfe.adjoint import EquilibriumTangent, refined
from softgrip_model.gdfe.closing import ClosingSettings, profile_material
from softgrip_model.gdfe.finger_gradient import MeshedFinger, joint_angle_goal, tension_goal, tip_goal
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.level_factor import LevelFactor, levels_of
from softgrip_model.gdfe.materials import Linear, StressPolynomial, neo_hookean
from softgrip_model.gdfe.solver import ConstitutiveLaw
from softgrip_model.profile import load_directory, shipped_directory

SETTINGS = ClosingSettings(RESOLUTIONS["coarse"], travel_mm=10.0)
#: [mm], and the share of moduli: far above what solves leave (1e-10), and their third derivatives do not show yet.
STEP = 2e-4
GOALS = [tip_goal([0.0, 1.0, 0.0]), joint_angle_goal(1), tension_goal()]


@pytest.fixture(scope="module")
def profile():
    return load_directory(shipped_directory())["power"]


def meshed(profile, variable=None, step=0.0, law=ConstitutiveLaw.CALIBRATED):
    """Return a finger whose variable number k of h, r, stiffness differs by a step."""
    finger = Finger.from_profile(profile, "index")
    material = profile_material(profile.material)
    if law is ConstitutiveLaw.RIGOROUS:
        material = neo_hookean("soft", 5.0, 0.3)
    n = finger.joints
    design = np.concatenate([finger.thickness_mm, finger.routing_mm])
    if variable is not None and variable < 3 * n:
        design[variable] += step
    elif variable == 3 * n:
        material = stiffer(material, 1.0 + step)
    return MeshedFinger(
        finger.with_design(design[:n], design[n:]), assumed_friction(profile).law, material, SETTINGS, law
    )


def stiffer(material, factor):
    if isinstance(material, StressPolynomial):
        return replace(material, coefficients=tuple(factor * one for one in material.coefficients))
    return neo_hookean(material.name, factor * material.shear_modulus, material.poisson)


def values(finger, pulled_mm):
    closed = finger.close(pulled_mm)
    vertices = finger.mesh.mesh.nodes + closed.displacement
    return np.array([goal(finger.mesh, vertices, closed.tension[0][0]).value for goal in GOALS])


def difference(profile, pulled_mm, variable, law):
    """Return the goals' slopes by whole solves."""
    if variable == "pulled":
        finger = meshed(profile, law=law)
        return (values(finger, pulled_mm + STEP) - values(finger, pulled_mm - STEP)) / (2.0 * STEP)
    more, less = (values(meshed(profile, variable, side * STEP, law), pulled_mm) for side in (1.0, -1.0))
    return (more - less) / (2.0 * STEP)


@pytest.mark.parametrize(
    ("law", "pulled_mm", "variables"),
    [(ConstitutiveLaw.CALIBRATED, 7.3, (0, 4, 9, "pulled")), (ConstitutiveLaw.RIGOROUS, 1.3, (1, "pulled"))],
)
def test_the_gradient_is_that_of_whole_solves(profile, law, pulled_mm, variables):
    finger = meshed(profile, law=law)
    found = np.array([one.numbers() for one in finger.gradients(finger.close(pulled_mm), pulled_mm, GOALS)])
    for variable in variables:
        expected = difference(profile, pulled_mm, variable, law)
        column = found[:, 10 if variable == "pulled" else variable]
        assert column == pytest.approx(expected, rel=1e-5, abs=1e-5 * float(np.abs(found).max(axis=1).min()))


def test_a_drawn_bar_of_one_material_has_the_closed_form():
    """A bar hung by its end: twice the modulus, half the displacement, so d u / d ln E = -u."""
    mesh = bar((10.0, 1.0, 1.0), (10, 1, 1))
    end = mesh.nodes_where(mesh.nodes[:, 0] > 10.0 - 1e-9)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(mesh.nodes_where(mesh.nodes[:, 0] < 1e-9))
    load = np.zeros_like(mesh.nodes)
    load[end, 0] = 1e-5
    solver = Solver(mesh, [Linear("steel", 1.0, 0.3)], supports)
    found = solver.solve(load=load, tolerance=1e-9)
    tangent = EquilibriumTangent(solver, found, [])
    slopes = np.zeros_like(mesh.nodes)
    slopes[end, 0] = 1.0 / len(end)
    drawn = float(found.displacement[end, 0].mean())
    assert tangent.by_stiffness(tangent.adjoint(slopes)) == pytest.approx(-drawn, rel=1e-4)


def test_levels_solve_what_a_dense_factor_solves():
    """A bar whose end moves as one along x: a level of its own, wherever its nodes are."""
    mesh = bar((6.0, 2.0, 1.0), (6, 2, 1))
    held, end = (mesh.nodes_where(np.abs(mesh.nodes[:, 0] - x) < 1e-9) for x in (0.0, 6.0))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(held).with_tied(end, "x")
    solver = Solver(mesh, [Linear("one", 1.0, 0.3)], supports)
    tangent = EquilibriumTangent(solver, solver.solve(load=np.full_like(mesh.nodes, 1e-4), tolerance=1e-8), [])
    right = np.random.default_rng(3).normal(size=(tangent.unknowns, 2))
    levels = levels_of(mesh.hexes, tangent.unknown_of, tangent.unknowns)
    assert len(np.unique(levels)) == 6
    expected = np.linalg.solve(tangent.stiffness.toarray(), right)
    assert LevelFactor(tangent.stiffness, levels).solve(right) == pytest.approx(expected, rel=1e-8)


def test_forces_are_the_same_without_a_solver(profile):
    for law in (ConstitutiveLaw.CALIBRATED, ConstitutiveLaw.RIGOROUS):
        solver = meshed(profile, law=law).solver
        moved = np.random.default_rng(5).normal(scale=0.01, size=solver.mesh.nodes.shape)
        alone = _core.ElementForces(solver.problem(), solver.settings.core()).at(moved)
        assert alone == pytest.approx(solver.internal_force(moved), rel=1e-9, abs=1e-9)


def test_what_has_no_gradient_is_refused(profile):
    finger = meshed(profile)
    slack = finger.solver.solve(drives=[CableDrive(0.0)], force_floor=1.0)
    with pytest.raises(GdfeError, match="taut cables"):
        finger.gradients(slack, 0.0, GOALS)
    with pytest.raises(GdfeError, match="converged"):
        EquilibriumTangent(finger.solver, replace(slack, converged=False), [CableDrive(0.0)])
    with pytest.raises(GdfeError, match="expected a residual"):
        refined(finger.solver, finger.solver.rest(), [CableDrive(60.0)], max_iterations=5)
    thesis = Solver(
        bar((1.0, 1.0, 1.0), (1, 1, 1)),
        [Linear("one", 1.0, 0.3)],
        Supports(np.ones((8, 3), dtype=bool)),
        settings=SolverSettings(law=ConstitutiveLaw.THESIS),
    )
    with pytest.raises(GdfeError, match="forgets stress"):
        EquilibriumTangent(thesis, replace(slack, converged=True), [])
