# SPDX-License-Identifier: Apache-2.0
"""Acceptance values of GDFE (docs/gdfe.md): unit reference, closed forms, published cases, CalculiX."""

import numpy as np
import pytest
from scipy.optimize import brentq

from softgrip_model.gdfe import ConstitutiveLaw, Linear, Solver, SolverSettings, Supports, VolumeShape, bar
from softgrip_model.gdfe.march import march
from softgrip_model.gdfe.materials import cheetah, cheetah_ogden, ninjaflex, ninjaflex_ogden
from softgrip_model.gdfe.solver import Metric
from softgrip_model.gdfe.thesis import (
    ThesisState,
    force_unit,
    material_constants,
    shape_factors_closed_form,
    shape_factors_published,
    stiffness_ratio,
)
from softgrip_model.gdfe.thesis_bars import difference, five_materials, joint_position, rotation, tension

UNIT_F = np.array([[1.3, 0.2, -0.1], [0.05, 0.9, 0.15], [-0.2, 0.1, 1.1]])
UNIT_STRAIN = 0.3551692469
UNIT_ROTATION = [
    [0.9972120940, 0.0643174476, 0.0378325992],
    [-0.0649799033, 0.9977493553, 0.0165479927],
    [-0.0366831269, -0.0189602171, 0.9991470654],
]
UNIT_VOLUME = {
    VolumeShape.SCALE: [
        [1.2126620400, 0.1865633908, -0.0932816954],
        [0.0466408477, 0.8395352584, 0.1399225431],
        [-0.1865633908, 0.0932816954, 1.0260986492],
    ],
    VolumeShape.PROJ: [
        [1.2482863259, 0.2062025198, -0.1110319786],
        [0.0640491404, 0.8210924429, 0.1614058381],
        [-0.2077220602, 0.1129430617, 1.0372212374],
    ],
}
UNIT_BLEND = {
    VolumeShape.SCALE: [
        [1.1264820616, 0.1376650135, -0.0408359775],
        [0.0019925473, 0.9028208972, 0.0905727229],
        [-0.1266112852, 0.0483849304, 1.0153180157],
    ],
    VolumeShape.PROJ: [
        [1.1478566332, 0.1494484909, -0.0514861475],
        [0.0124375229, 0.8917552079, 0.1034626999],
        [-0.1393064869, 0.0601817502, 1.0219915686],
    ],
}


def cube_solver(omega, shape):
    mesh = bar((1.0, 1.0, 1.0), (1, 1, 1))
    settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=shape)
    supports = Supports.none(8).with_prescribed(np.arange(8, dtype=np.int32))
    solver = Solver(mesh, [Linear("any", 1.0, 0.3)], supports, settings=settings)
    solver.set_thesis_state(np.array([omega]), np.zeros(1))
    return solver


@pytest.mark.parametrize("shape", list(VolumeShape))
@pytest.mark.parametrize(
    ("omega", "goal"),
    [
        (0.4, UNIT_BLEND),
        (0.0, UNIT_VOLUME),  # nothing but the volume-conserving shape
        (1.0, dict.fromkeys(VolumeShape, UNIT_ROTATION)),  # nothing but the rotated rest shape
    ],
    ids=["blend", "volume", "rotation"],
)
def test_unit_reference(shape, omega, goal):
    solver = cube_solver(omega, shape)
    rest = solver.mesh.nodes
    force = solver.internal_force(rest @ UNIT_F.T - rest)
    # on a unit cube the forces of the affine state are G P^T with G = X / 2, P = F - F_B
    p = force.T @ rest  # X^T X = 2 I
    np.testing.assert_allclose(UNIT_F - p, goal[shape], atol=1e-9)
    assert solver.strain()[0] == pytest.approx(UNIT_STRAIN, abs=1e-9)


@pytest.mark.parametrize("shape", list(VolumeShape))
def test_a_rigid_motion_leaves_no_residual(shape):
    case, materials = five_materials()
    solver = Solver(case.mesh, materials, case.supports, settings=SolverSettings(volume_shape=shape))
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    k = np.cross(np.eye(3), -axis)
    turn = np.eye(3) + np.sin(2.5) * k + (1 - np.cos(2.5)) * k @ k
    moved = case.mesh.nodes @ turn.T + [3.0, -7.0, 11.0]
    assert np.abs(solver.internal_force(moved - case.mesh.nodes)).max() < 1e-10


@pytest.mark.parametrize("shape", list(VolumeShape))
@pytest.mark.parametrize("omega", [0.1, 0.5, 0.9])
def test_small_strain_modulus_and_poisson_ratio_of_a_shape_factor(omega, shape):
    stretch = 1e-6
    modulus, poisson = material_constants(omega)
    assert modulus == pytest.approx(3.0 * omega / (2.0 + omega))
    assert poisson == pytest.approx((1.0 - omega) / (2.0 + omega))
    solver = cube_solver(omega, shape)
    rest = solver.mesh.nodes
    force = solver.internal_force(rest * [stretch, -poisson * stretch, -poisson * stretch])
    assert force[rest[:, 0] > 0.5, 0].sum() / stretch == pytest.approx(modulus, rel=1e-4)
    assert np.abs(force[:, 1:]).max() < 1e-4 * modulus * stretch


def test_stiffness_ratio_in_closed_form():
    assert stiffness_ratio(np.array(0.9), np.array(0.03)) == pytest.approx(21.00, abs=0.005)
    np.testing.assert_allclose(
        stiffness_ratio(np.array(0.9), 0.9 / np.array([10.0, 30.0])),
        0.6897 * np.array([10.0, 30.0]) + 0.3103,
        rtol=1e-4,
    )


@pytest.mark.parametrize(
    ("pair", "joint", "stress"),
    [((cheetah(), ninjaflex()), 33.02, 3.980), ((cheetah_ogden(), ninjaflex_ogden()), 34.87, None)],
)
def test_one_dimensional_equilibrium_of_two_materials(pair, joint, stress):
    left, right = pair

    def unbalance(stretch):
        return float(left.nominal_stress(np.array(stretch)) - right.nominal_stress(np.array(4.0 - stretch)))

    stretch = brentq(unbalance, 1.05, 1.9)
    assert 25.0 * stretch == pytest.approx(joint, abs=0.006)
    if stress is not None:
        assert float(left.nominal_stress(np.array(stretch))) == pytest.approx(stress, rel=1e-3)


@pytest.mark.parametrize(
    ("material", "stretch", "stress"),
    [
        (cheetah_ogden(), 2.0, 6.096),
        (ninjaflex_ogden(), 2.0, 3.691),
        (cheetah_ogden(), 3.0, 8.521),
        (ninjaflex_ogden(), 3.0, 4.922),
    ],
)
def test_nominal_stress_of_the_ogden_constants(material, stretch, stress):
    assert float(material.nominal_stress(np.array(stretch))) == pytest.approx(stress, abs=6e-4)


@pytest.mark.parametrize(("shape", "joint"), [(VolumeShape.PROJ, 30.58), (VolumeShape.SCALE, 33.67)])
def test_thesis_law_in_ten_increments_of_tension(shape, joint):
    materials = (cheetah(), ninjaflex())
    case, used = tension(materials=materials)
    settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=shape, metric=Metric.CENTRING, step_limit=1.0)
    solver = Solver(case.mesh, used, case.supports, settings=settings)
    state = ThesisState(solver, materials, shape_factors_published)
    found = march(solver, case.loading, 10, tolerance=1e-9, first_guess=case.first_guess, before=state.before)
    assert found.completed
    assert 100.0 * joint_position(case, found.last.displacement) == pytest.approx(joint, abs=0.02)


def test_five_materials_by_shape_factors_against_calculix():
    case, materials = five_materials()
    settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=VolumeShape.SCALE)
    solver = Solver(case.mesh, materials, case.supports, settings=settings)
    state = ThesisState(solver, materials, shape_factors_closed_form, previous_shape=False, update=False)
    found = march(solver, case.loading, 1, tolerance=1e-7, before=state.before)
    mean, _ = difference(found.last.displacement, case.reference())
    assert found.completed
    assert mean < 0.003
    reaction = found.last.reaction[case.right, 1].sum() * force_unit(state.moduli, state.omega)
    assert reaction == pytest.approx(2.604, abs=0.005)


@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_five_materials_by_the_calibrated_law_against_calculix(poisson):
    case, materials = five_materials(poisson=poisson)
    solver = Solver(case.mesh, materials, case.supports, settings=SolverSettings(volume_shape=VolumeShape.SCALE))
    found = march(solver, case.loading, 1)
    mean, largest = difference(found.last.displacement, case.reference())
    assert found.completed
    assert mean < 0.003
    assert largest < 0.006


def test_tension_of_ogden_materials_by_the_calibrated_law():
    """Joint and force are CalculiX', C3D8R, nu 0.49."""
    case, materials = tension(poisson=0.49)
    solver = Solver(case.mesh, materials, case.supports)
    found = march(solver, case.loading, 2, first_guess=case.first_guess)
    assert found.completed
    assert 100.0 * joint_position(case, found.last.displacement) == pytest.approx(35.31, abs=0.03)
    assert -found.last.reaction[case.left, 0].sum() == pytest.approx(452.0, abs=1.0)
    mean, _ = difference(found.last.displacement, case.reference())
    assert mean < 0.002


def test_rotation_by_the_calibrated_law_against_calculix():
    case, materials = rotation()
    solver = Solver(case.mesh, materials, case.supports)
    found = march(solver, case.loading, 10)
    mean, largest = difference(found.last.displacement, case.reference())
    assert found.completed
    assert mean < 0.002
    assert largest < 0.006


def test_tension_by_the_rigorous_law():
    case, materials = tension(poisson=0.49)
    solver = Solver(
        case.mesh,
        materials,
        case.supports,
        settings=SolverSettings(law=ConstitutiveLaw.RIGOROUS, window=20, step_limit=1.0),
    )
    found = march(solver, case.loading, 10, first_guess=case.first_guess)
    assert found.completed
    assert 100.0 * joint_position(case, found.last.displacement) == pytest.approx(35.50, abs=0.01)
    assert -found.last.reaction[case.left, 0].sum() / 100.0 == pytest.approx(4.5455, abs=0.002)


def test_rotation_by_the_rigorous_law_against_calculix():
    case, materials = rotation(poisson=0.49)
    solver = Solver(
        case.mesh,
        materials,
        case.supports,
        settings=SolverSettings(law=ConstitutiveLaw.RIGOROUS, window=20, step_limit=1.0),
    )
    found = march(solver, case.loading, 10)
    mean, largest = difference(found.last.displacement, case.reference())
    assert found.completed
    assert mean < 0.001
    assert largest < 0.005
