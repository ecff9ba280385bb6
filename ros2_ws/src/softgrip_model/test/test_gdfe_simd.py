# SPDX-License-Identifier: Apache-2.0
"""One build, every instruction set: each that this machine runs gives the same answer."""

import numpy as np
import pytest
from scipy.optimize import brentq

from softgrip_model.gdfe import (
    ConstitutiveLaw,
    Linear,
    Method,
    Solver,
    SolverSettings,
    State,
    Supports,
    VolumeShape,
    _core,
    bar,
)
from softgrip_model.gdfe.materials import cheetah, ninjaflex


@pytest.fixture
def instruction_set():
    yield _core.use_simd_target
    _core.use_simd_target("")


def solved(shape=VolumeShape.PROJ, **settings):
    mesh = bar((16.0, 4.0, 4.0), (16, 5, 5), 2)
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 16.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)
    moved = np.zeros_like(mesh.nodes)
    moved[right] = [3.0, 2.0, 0.0]
    settings = SolverSettings(volume_shape=shape, **settings)
    solver = Solver(mesh, [cheetah(), ninjaflex()], supports, settings=settings)
    found = solver.solve(moved, start=State(0.3 * moved), tolerance=1e-9, max_iterations=4000)
    assert found.converged
    return found


def test_the_build_has_more_than_one_instruction_set_and_runs_the_best():
    targets = _core.simd_targets()
    assert len(targets) >= 2  # one that every machine of this kind runs, and a better one
    assert _core.simd_target() == targets[0]


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"shape": VolumeShape.SCALE},
        {"single_precision_factor": False},
        {"method": Method.MULTIGRID},
        {"method": Method.MULTIGRID, "single_precision_factor": False},
    ],
    ids=str,
)
def test_every_instruction_set_gives_the_same_answer(instruction_set, settings):
    answers = {}
    for name in _core.simd_targets():
        instruction_set(name)
        assert _core.simd_target() == name
        answers[name] = solved(**settings)
    best = next(iter(answers.values()))
    for name, found in answers.items():
        np.testing.assert_allclose(found.displacement, best.displacement, atol=1e-7, err_msg=name)
        np.testing.assert_allclose(found.strain, best.strain, atol=1e-7, err_msg=name)


def test_inverted_elements_are_survived_by_every_instruction_set(instruction_set):
    mesh = bar((4.0, 2.0, 2.0), (4, 2, 2))
    left = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    pushed = np.zeros_like(mesh.nodes)
    pushed[np.argmin(np.linalg.norm(mesh.nodes - [2.0, 0.0, 0.0], axis=1)), 0] = 1.4  # through its neighbours
    for name in _core.simd_targets():
        instruction_set(name)
        for method in (Method.DIRECT, Method.MULTIGRID):
            settings = SolverSettings(law=ConstitutiveLaw.CALIBRATED, method=method, step_limit=0.5)
            supports = Supports.none(len(mesh.nodes)).with_prescribed(left)
            solver = Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=settings)
            found = solver.solve(start=State(pushed), force_floor=1.0, max_iterations=4000)
            assert found.converged, name
            assert np.abs(found.displacement).max() < 1e-3


def test_an_instruction_set_that_is_not_there_is_refused(instruction_set):
    with pytest.raises(ValueError, match="MMX"):
        instruction_set("MMX")


def turned(rng):
    """A rotation, by the QR decomposition of random numbers."""
    turn, triangle = np.linalg.qr(rng.normal(size=(3, 3)))
    turn = turn * np.sign(np.diag(triangle))
    return turn if np.linalg.det(turn) > 0 else -turn


def nearest_of_unit_volume(stretches):
    """Principal stretches t nearest to s with product 1: t - s = l / t for one l."""
    t = lambda l: (stretches + np.sqrt(np.maximum(stretches**2 + 4.0 * l, 0.0))) / 2.0  # noqa: E731, E741
    return t(brentq(lambda l: np.prod(t(l)) - 1.0, -0.25 * stretches.min() ** 2, 100.0, xtol=1e-15, rtol=1e-14))  # noqa: E741


@pytest.mark.parametrize("target", _core.simd_targets())
def test_rotation_and_nearest_volume_are_those_of_the_singular_values(instruction_set, target):
    instruction_set(target)
    mesh = bar((1.0, 1.0, 1.0), (1, 1, 1))
    supports = Supports.none(8).with_prescribed(np.arange(8, dtype=np.int32))
    parts = []
    for omega in (1.0, 0.0):  # nothing but the rotated rest shape, nothing but the volume-conserving one
        solver = Solver(mesh, [Linear("any", 1.0, 0.3)], supports, settings=SolverSettings(law=ConstitutiveLaw.THESIS))
        solver.set_thesis_state(np.array([omega]), np.zeros(1))
        # on a unit cube the forces of the affine state are G P^T with G = X / 2, P = F - what is aimed at
        parts.append(lambda f, s=solver: f - s.internal_force(mesh.nodes @ f.T - mesh.nodes).T @ mesh.nodes)
    rotation, volume = parts
    rng = np.random.default_rng(6)
    for trial in range(200):
        left, right = turned(rng), turned(rng)
        far = np.exp(rng.uniform(np.log(0.12), np.log(6.0), 3))
        near = np.exp(rng.uniform(np.log(0.8), np.log(1.16), 3))  # det F of 0.512 .. 1.56
        for stretches in (far, near):
            stretches[1] = stretches[0] if trial % 4 == 0 else stretches[1]  # two alike: no distinct singular vectors
        np.testing.assert_allclose(rotation(left * far @ right.T), left @ right.T, atol=1e-10)
        expected = left * nearest_of_unit_volume(near) @ right.T
        np.testing.assert_allclose(volume(left * near @ right.T), expected, atol=1e-9)
