# SPDX-License-Identifier: Apache-2.0
"""Multigrid in place of the factor: the same answers, and iterations that do not grow with the mesh."""

import numpy as np
import pytest

from softgrip_model.finger import FRICTIONLESS
from softgrip_model.gdfe import (
    CableDrive,
    ConstitutiveLaw,
    GdfeError,
    Linear,
    Mesh,
    Method,
    RoutedCable,
    RoutingPoint,
    Solver,
    SolverSettings,
    Supports,
    bar,
)
from softgrip_model.gdfe.materials import cheetah, neo_hookean, ninjaflex

BOTH = (Method.DIRECT, Method.MULTIGRID)


def drawn_bar(
    shape,
    method,
    materials,
    *,
    size=(40.0, 10.0, 10.0),
    distort=0.0,
    shuffled=False,
    tied=False,
    tolerance=1e-8,
    **settings,
):
    """Return the solve of a bar of two materials, one end moved by a tenth along and across."""
    mesh = bar(size, shape, 2)
    if shuffled:
        order = np.random.default_rng(3).permutation(len(mesh.nodes))
        mesh = Mesh(mesh.nodes[order], np.argsort(order)[mesh.hexes].astype(np.int32), mesh.materials)
    left = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    right = mesh.nodes_where(mesh.nodes[:, 0] == size[0])
    if distort:
        inside = (np.abs(mesh.nodes - [size[0] / 2, 0, 0]) < np.array(size) / 2 - 1e-9).all(axis=1)
        shift = distort * np.array(size) / shape * np.random.default_rng(7).uniform(-1, 1, mesh.nodes.shape)
        mesh = Mesh(mesh.nodes + inside[:, None] * shift, mesh.hexes, mesh.materials)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right, "yz")
    supports = supports.with_tied(right, "x") if tied else supports.with_prescribed(right)
    moved = np.zeros_like(mesh.nodes)
    moved[right] = [0.1 * size[0], 0.1 * size[0], 0.0]
    solver = Solver(mesh, materials, supports, settings=SolverSettings(method=method, **settings))
    return solver.solve(moved, tolerance=tolerance, max_iterations=4000)


CASES = {
    "two materials": {"materials": [cheetah(), ninjaflex()]},
    "moduli 100 : 1": {"materials": [Linear("hard", 100.0, 0.3), Linear("soft", 1.0, 0.3)]},
    "flat elements": {"materials": [cheetah(), ninjaflex()], "size": (40.0, 10.0, 1.0)},
    "long elements": {"materials": [cheetah(), ninjaflex()], "size": (200.0, 5.0, 5.0)},
    "distorted elements": {"materials": [cheetah(), ninjaflex()], "distort": 0.25},
    "nodes in any order": {"materials": [cheetah(), ninjaflex()], "shuffled": True},
    "tied face": {"materials": [cheetah(), ninjaflex()], "tied": True},
    "double": {"materials": [cheetah(), ninjaflex()], "single_precision_factor": False},
    "rigorous": {
        "materials": [neo_hookean("a", 3.0, 0.4), neo_hookean("b", 1.0, 0.4)],
        "law": ConstitutiveLaw.RIGOROUS,
    },
}


@pytest.mark.parametrize("name", CASES)
def test_multigrid_and_the_factor_give_one_answer(name):
    direct, multigrid = (drawn_bar((16, 8, 8), method, **CASES[name]) for method in BOTH)
    assert direct.converged
    assert multigrid.converged
    scale = np.abs(direct.displacement).max()
    np.testing.assert_allclose(multigrid.displacement, direct.displacement, atol=1e-6 * scale)
    assert multigrid.iterations < 3 * direct.iterations


def test_iterations_do_not_grow_with_the_mesh():
    materials = [cheetah(), ninjaflex()]
    counts = {
        shape: drawn_bar(shape, Method.MULTIGRID, materials, tolerance=1e-6).iterations
        for shape in [(40, 5, 5), (80, 10, 10), (124, 16, 16)]
    }
    assert max(counts.values()) <= 2 * min(counts.values()), counts


@pytest.mark.parametrize("threads", [2, 3])
def test_the_cycle_does_not_depend_on_the_number_of_threads(threads):
    materials = [cheetah(), ninjaflex()]
    one, more = (drawn_bar((16, 8, 8), Method.MULTIGRID, materials, threads=count) for count in (1, threads))
    np.testing.assert_allclose(more.displacement, one.displacement, atol=1e-7)


def test_a_driven_cable_finds_its_tension_without_a_factor():
    mesh = bar((80.0, 10.0, 10.0), (64, 5, 5))
    left = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    lower = [
        mesh.nodes_where((mesh.nodes[:, 0] == x) & (mesh.nodes[:, 1] == -5.0)) for x in np.arange(10.0, 81.0, 10.0)
    ]
    points = [RoutingPoint(tuple(mesh.nodes[n].mean(axis=0)), n, np.full(len(n), 1.0 / len(n))) for n in lower]
    base = RoutingPoint((0.0, -5.0, 0.0), np.zeros(0, dtype=np.int32), np.zeros(0))
    found = {}
    for method in BOTH:
        supports = Supports.none(len(mesh.nodes)).with_prescribed(left)
        settings = SolverSettings(method=method, window=30)
        solver = Solver(
            mesh, [Linear("MPa", 1.0, 0.3)], supports, [RoutedCable((base, *points), FRICTIONLESS)], settings
        )
        found[method] = solver.solve(drives=[CableDrive(2.0)], tolerance=1e-7, max_iterations=4000)
        assert found[method].converged
    direct, multigrid = (found[method] for method in BOTH)
    assert multigrid.anchor_tension[0] == pytest.approx(direct.anchor_tension[0], rel=1e-4)
    np.testing.assert_allclose(multigrid.displacement, direct.displacement, atol=1e-3)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("held", ["", "x"], ids=["nowhere", "along x only"])
def test_a_mesh_that_is_not_held_is_refused_by_multigrid_too(held, threads):
    mesh = bar((16.0, 8.0, 8.0), (16, 8, 8))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(mesh.nodes_where(mesh.nodes[:, 0] == 0.0), held)
    with pytest.raises(GdfeError, match="not held"):
        Solver(
            mesh, [Linear("any", 1.0, 0.3)], supports, settings=SolverSettings(method=Method.MULTIGRID, threads=threads)
        )
