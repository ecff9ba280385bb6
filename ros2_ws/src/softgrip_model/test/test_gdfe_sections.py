# SPDX-License-Identifier: Apache-2.0
"""Rigid cross-sections as a second level: the same equilibria in far fewer iterations where a body bends much."""

from functools import partial

import numpy as np
import pytest

from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.gdfe import (
    CableDrive,
    GdfeError,
    Linear,
    Obstacle,
    ObstacleShape,
    RoutedCable,
    Solver,
    SolverSettings,
    Supports,
    Surroundings,
    bar,
)
from softgrip_model.gdfe.cable import attach, guide
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.profile import load_directory, shipped_directory

#: [mm] Sixty times as long as thick.
LENGTH, SIZE = 60.0, (60.0, 2.0, 1.0)
SOFT = Linear("soft", 10.0, 0.0)


def strip(sections_after=-1, *, elements=(40, 2, 2), cables=(), ends=1, surroundings=None, sections=None, **settings):
    mesh = bar(SIZE, elements)
    held = mesh.nodes[:, 0] < 1e-9
    if ends == 2:
        held |= mesh.nodes[:, 0] > LENGTH - 1e-9
    supports = Supports.none(len(mesh.nodes)).with_prescribed(np.flatnonzero(held))
    method = SolverSettings(sections_after=sections_after, **settings)
    return Solver(mesh, [SOFT], supports, [make(mesh) for make in cables], method, surroundings, sections)


def load_at(solver, x, force_n):
    """[N] along the thickness, shared by the nodes there."""
    there = np.abs(solver.mesh.nodes[:, 0] - x) < 1e-9
    load = np.zeros_like(solver.mesh.nodes)
    load[there, 2] = force_n / there.sum()
    return load


def solve(solver, **task):
    found = solver.solve(**{"tolerance": 1e-6, "force_floor": 1e-9, "max_iterations": 5000, **task})
    assert found.converged
    return found


@pytest.mark.parametrize(("force_n", "deflection", "fewer"), [(2e-5, 0.2, 10), (5e-4, 5.0, 10), (3e-3, 25.0, 1)])
def test_a_strip_bends_as_without_them_in_far_fewer_iterations(force_n, deflection, fewer):
    plain, quick = strip(window=60), strip(4)
    expected, found = (solve(solver, load=load_at(solver, LENGTH, force_n)) for solver in (plain, quick))
    assert np.abs(expected.displacement).max() > deflection
    assert found.iterations < expected.iterations / fewer
    np.testing.assert_allclose(found.displacement, expected.displacement, atol=1e-4 * deflection)


def test_they_find_an_equilibrium_that_the_constant_matrix_alone_does_not():
    solver = strip(4, elements=(60, 2, 4))
    load = load_at(solver, LENGTH, 5e-4)
    alone = strip(elements=(60, 2, 4), window=60).solve(load=load, tolerance=1e-6, force_floor=1e-9, max_iterations=600)
    assert not alone.converged
    found = solve(solver, load=load)
    free = ~solver.supports.prescribed[:, 0]
    out_of_balance = (load - solver.internal_force(found.displacement))[free]
    assert np.linalg.norm(out_of_balance) < 1e-5 * np.linalg.norm(found.reaction)
    assert found.reaction.sum(axis=0) == pytest.approx([0.0, 0.0, -5e-4], abs=1e-8)


def test_a_body_held_at_both_ends_has_sections_from_both():
    plain, quick = strip(ends=2, window=60), strip(0, ends=2)
    expected, found = (solve(solver, load=load_at(solver, 0.5 * LENGTH, 0.02)) for solver in (plain, quick))
    np.testing.assert_allclose(found.displacement, expected.displacement, atol=1e-4 * expected.displacement[:, 2].max())


FRICTION = (0.2, 0.1)
ABOVE = (0.4, -0.4)


def cable(mesh, height, friction):
    """Along the strip at a height over its middle: that is where it pulls it to."""
    points = [attach(mesh, (x, 0.0, height)) for x in (15.0, 30.0, 45.0, 59.0)]
    return RoutedCable((guide((0.0, 0.0, height)), *points), FrictionLaw(Law.CAPSTAN, (friction,), 1.0))


PULLS = {
    "a length": [CableDrive(0.5)],
    "a tension": [CableDrive(0.005, by_length=False)],
    "two lengths": [CableDrive(0.5), CableDrive(0.1)],
    "a length against a tension": [CableDrive(0.5), CableDrive(0.002, by_length=False)],
    "a slack one": [CableDrive(0.5), CableDrive(-1.0)],
}


@pytest.mark.parametrize("name", PULLS)
@pytest.mark.parametrize("after", [0, 4])
def test_cables_that_bend_it_far_are_in_balance_with_it(name, after):
    """By forces, lengths and the capstan's equation worked out here."""
    drives = PULLS[name]
    cables = [partial(cable, height=z, friction=mu) for z, mu in zip(ABOVE, FRICTION, strict=True)][: len(drives)]
    solver = strip(after, cables=cables, step_limit=0.5, window=20)
    found = solve(solver, drives=drives, length_tolerance=1e-6, max_iterations=600)
    balance = -solver.internal_force(found.displacement)
    for drive, line, friction, tension in zip(drives, solver.cables, FRICTION, found.tension, strict=False):
        points = np.array(
            [
                p.weights @ (solver.mesh.nodes + found.displacement)[p.nodes] if len(p.nodes) else p.position
                for p in line.points
            ]
        )
        spans = np.diff(points, axis=0)
        length = np.linalg.norm(spans, axis=1)
        # the guide at the support has an entry along -x, and rubs too
        along = np.vstack([[1.0, 0.0, 0.0], spans / length[:, None]])
        angle = np.arccos(np.clip((along[1:] * along[:-1]).sum(axis=1), -1.0, 1.0))
        np.testing.assert_allclose(tension[:-1], np.multiply(tension[1:], np.exp(friction * angle)), rtol=1e-5)
        if not drive.by_length:
            assert tension[0] == pytest.approx(drive.target)
        elif tension[-1] > 0.0:
            assert 59.0 - length.sum() == pytest.approx(drive.target, abs=2e-6)
        else:
            assert 59.0 - length.sum() > drive.target
        pull = np.multiply(tension, 1.0)[:, None] * along
        for k, point in enumerate(line.points[1:], start=1):
            force = (pull[k + 1] if k + 1 < len(pull) else 0.0) - pull[k]
            balance[point.nodes] += point.weights[:, None] * force
    free = ~solver.supports.prescribed[:, 0]
    largest = max(tension[0] for tension in found.tension)
    assert np.linalg.norm(balance[free]) < 1e-4 * largest
    assert np.abs(found.displacement[:, 2]).max() > 0.5


def test_the_shipped_fingers_need_a_third_of_the_iterations_at_most(monkeypatch):
    """And the tendon buckles none: what it pulls together turns with it."""
    for name, profile in load_directory(shipped_directory()).items():
        chains = []
        for after, window in ((-1, 60), (6, 20)):
            monkeypatch.setattr("softgrip_model.gdfe.closing.SECTIONS_AFTER", after)
            monkeypatch.setattr("softgrip_model.gdfe.closing.WINDOW", window)
            settings = ClosingSettings(tolerance=1e-5, travel_mm=12.0, max_iterations=2000)
            closing = ClosingPath(profile, "index", settings, body=Body(profile, "index", settings.resolution))
            closing.keyframes.cover(12.0)
            chains.append(closing.keyframes._known)
        plain, quick = (sum(one.iterations for one in chain) for chain in chains)
        assert quick < plain / 3, name
        assert max(one.iterations for one in chains[1]) < 60, name
        for alone, both in zip(*chains, strict=True):
            np.testing.assert_allclose(both.displacement, alone.displacement, atol=0.02)


def test_bits_do_not_depend_on_what_was_solved_before():
    fresh, used = strip(2, threads=2), strip(2, threads=2)
    solve(used, load=load_at(used, LENGTH, -1e-3))
    first, second = (solve(solver, load=load_at(solver, LENGTH, 5e-4)) for solver in (fresh, used))
    np.testing.assert_array_equal(first.displacement, second.displacement)
    one = solve(strip(2), load=load_at(fresh, LENGTH, 5e-4))
    np.testing.assert_allclose(first.displacement, one.displacement, atol=1e-3)


def test_two_nodes_are_no_rigid_body_and_left_to_the_constant_matrix():
    mesh = bar((1.0, 1.0, 1.0), (1, 1, 1))
    supports = Supports.none(8).with_prescribed(np.arange(6))
    load = np.zeros((8, 3))
    load[6:, 0] = 0.1
    plain, quick = (Solver(mesh, [SOFT], supports, settings=SolverSettings(sections_after=k)) for k in (-1, 0))
    np.testing.assert_array_equal(solve(quick, load=load).displacement, solve(plain, load=load).displacement)


def test_a_body_without_a_free_node_has_none():
    mesh = bar((1.0, 1.0, 1.0), (1, 1, 1))
    held = Supports.none(8).with_prescribed(np.arange(8))
    assert Solver(mesh, [SOFT], held, settings=SolverSettings(sections_after=0)).solve(0.1 * mesh.nodes).converged


def test_sections_that_are_given_as_they_would_be_counted_change_no_bit():
    counted = strip(4)
    layer = np.round(counted.mesh.nodes[:, 0] / (LENGTH / 40)).astype(np.int32) - 1  # -1: held, not looked at
    given = strip(4, sections=layer)
    load = load_at(counted, LENGTH, 5e-4)
    one, other = (solve(solver, load=load) for solver in (counted, given))
    assert one.iterations == other.iterations
    np.testing.assert_array_equal(one.displacement, other.displacement)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda layer: layer[:-1], "expected one for each of 369 nodes, found 368"),
        (lambda layer: layer + (layer == 20), "expected nodes in each, found an empty one"),
        (
            lambda layer: np.where(np.cumsum(layer == 30) == 1, 25, layer),
            "only neighbours meet in an element",
        ),
        (lambda layer: layer - 8, "expected numbers from 0, found -8"),
    ],
)
def test_sections_that_are_none_are_refused(change, expected):
    nodes = bar(SIZE, (40, 2, 2)).nodes
    layer = np.round(nodes[:, 0] / (LENGTH / 40)).astype(np.int32) - 1
    with pytest.raises(GdfeError, match=expected):
        strip(4, sections=change(layer).astype(np.int32))


def test_what_they_do_not_know_is_refused():
    with pytest.raises(GdfeError, match=r"sections_after: expected .* no obstacles"):
        strip(0, surroundings=Surroundings(obstacles=(Obstacle(ObstacleShape.PLANE, (0.0, 0.0, -1.0), np.arange(9)),)))
    mesh = bar(SIZE, (4, 1, 1))
    left, right = (mesh.nodes_where(np.abs(mesh.nodes[:, 0] - x) < 1e-9) for x in (0.0, LENGTH))
    held = Supports.none(len(mesh.nodes)).with_prescribed(left)
    for supports in (held.with_tied(right, "x"), held.with_prescribed(right, "x")):
        with pytest.raises(GdfeError, match="none tied"):
            Solver(mesh, [SOFT], supports, settings=SolverSettings(sections_after=0))
