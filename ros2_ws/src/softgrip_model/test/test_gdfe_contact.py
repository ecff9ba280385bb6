# SPDX-License-Identifier: Apache-2.0
"""Rigid obstacles: balance of forces, Hertz, Coulomb's cone, a strip around a cylinder, no penetration, refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq

from softgrip_model.gdfe import (
    Acts,
    GdfeError,
    Linear,
    Mesh,
    Obstacle,
    ObstacleShape,
    Solver,
    SolverSettings,
    Supports,
    Surroundings,
    bar,
)
from softgrip_model.gdfe.mesh import grid_hexes
from softgrip_model.gdfe.surroundings import face_shares


def pressed_bar(friction, poisson=0.0):
    """A bar standing on x = 0, its end x = 4 under a plane; base 2 x 2, E = 3."""
    mesh = bar((4.0, 2.0, 2.0), (4, 2, 2))
    base, end = (mesh.nodes_where(mesh.nodes[:, 0] == x) for x in (0.0, 4.0))
    plane = Obstacle(ObstacleShape.PLANE, (4.0, 0.0, 0.0), end, axis=(-1.0, 0.0, 0.0), friction=friction)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(base)
    solver = Solver(mesh, [Linear("any", 3.0, poisson)], supports, surroundings=Surroundings(obstacles=(plane,)))
    return solver, end


def test_a_plane_presses_a_bar_with_hookes_force():
    solver, end = pressed_bar(0.0)
    found = solver.solve(acts=Acts(motions=((-0.2, 0.0, 0.0),)), tolerance=1e-8)
    (contact,) = found.contacts
    assert found.converged
    np.testing.assert_allclose(contact.total, [-3.0 * 4.0 * 0.2 / 4.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.reaction.sum(axis=0) + contact.total, 0.0, atol=1e-6)
    assert sorted(contact.nodes) == sorted(end)
    assert np.abs(contact.gap).max() < 1e-6


def test_a_plane_that_leaves_pulls_nothing():
    solver, _ = pressed_bar(0.5)
    found = solver.solve(acts=Acts(motions=((0.1, 0.0, 0.0),)), force_floor=1.0)
    assert found.converged
    assert not len(found.contacts[0].nodes)
    assert np.abs(found.displacement).max() < 1e-9


def test_friction_holds_within_its_cone():
    friction = 0.4
    solver, _ = pressed_bar(friction, poisson=0.3)
    pressed = solver.solve(acts=Acts(motions=((-0.2, 0.0, 0.0),)), tolerance=1e-8)
    held = solver.solve(acts=Acts(motions=((-0.2, 0.01, 0.0),)), since=pressed, start=pressed.state, tolerance=1e-8)
    (contact,) = held.contacts
    assert held.converged
    size = np.linalg.norm(contact.force[:, 1:], axis=1)
    assert (size <= friction * -contact.force[:, 0] * (1 + 1e-9)).all()
    stuck = contact.nodes[~contact.sliding]
    assert len(stuck) >= 1
    np.testing.assert_allclose(held.displacement[stuck, 1] - pressed.displacement[stuck, 1], 0.01, atol=1e-6)


def test_friction_slides_on_its_cone():
    friction = 0.1
    solver, _ = pressed_bar(friction, poisson=0.3)
    pressed = solver.solve(acts=Acts(motions=((-0.2, 0.0, 0.0),)), tolerance=1e-8)
    dragged = solver.solve(acts=Acts(motions=((-0.2, 0.5, 0.0),)), since=pressed, start=pressed.state, tolerance=1e-8)
    (contact,) = dragged.contacts
    assert dragged.converged
    assert contact.sliding.all()
    np.testing.assert_allclose(
        np.linalg.norm(contact.force[:, 1:], axis=1), friction * -contact.force[:, 0], rtol=1e-6, atol=1e-9
    )
    assert contact.total[1] == pytest.approx(-friction * contact.total[0], rel=0.02)  # all but straight along y
    np.testing.assert_allclose(dragged.reaction.sum(axis=0) + contact.total, 0.0, atol=1e-6)


def graded_block(size, finest, count):
    """Quarter of a half space under the origin, x and y from 0, z down; cells grow away from it."""
    growth = brentq(lambda q: finest * (q**count - 1.0) / (q - 1.0) - size, 1.0 + 1e-6, 10.0)
    steps = finest * growth ** np.arange(count)
    line = np.concatenate([[0.0], np.cumsum(steps)])
    nodes = np.stack(np.meshgrid(line, line, -line[::-1], indexing="ij"), axis=-1).reshape(-1, 3)
    hexes = grid_hexes((count, count, count))
    return Mesh(nodes, hexes, np.zeros(len(hexes), dtype=np.int32))


def test_a_sphere_is_pushed_back_as_hertz_says():
    modulus, poisson, radius, depth = 2.0, 0.3, 10.0, 0.04
    force = 4.0 / 3.0 * modulus / (1 - poisson**2) * np.sqrt(radius * depth**3)
    mesh = graded_block(8.0, 0.09, 13)
    x, y, z = mesh.nodes.T
    far = mesh.nodes_where((x == x.max()) | (y == y.max()) | (z == z.min()))
    supports = Supports.none(len(x)).with_prescribed(far)
    supports = supports.with_prescribed(mesh.nodes_where(x == 0.0), "x").with_prescribed(
        mesh.nodes_where(y == 0.0), "y"
    )
    # far away the half space moves as under Boussinesq's point force
    prescribed = np.zeros_like(mesh.nodes)
    r = np.linalg.norm(mesh.nodes[far], axis=1)
    down = -z[far]
    scale = force * (1 + poisson) / (2 * np.pi * modulus)
    outward = scale * (down / r**3 - (1 - 2 * poisson) / (r * (r + down)))
    prescribed[far] = np.stack(
        [outward * x[far], outward * y[far], -scale * (down**2 / r**3 + 2 * (1 - poisson) / r)], 1
    )
    sphere = Obstacle(ObstacleShape.SPHERE, (0.0, 0.0, radius), mesh.nodes_where(z == 0.0), radius=radius)
    around = Surroundings(obstacles=(sphere,))
    solver = Solver(mesh, [Linear("any", modulus, poisson)], supports, surroundings=around)
    found = solver.solve(prescribed, acts=Acts(motions=((0.0, 0.0, -depth),)), tolerance=1e-6)
    (contact,) = found.contacts
    assert found.converged
    assert -4.0 * contact.total[2] == pytest.approx(force, rel=0.05)
    assert np.hypot(x, y)[contact.nodes].max() == pytest.approx(np.sqrt(radius * depth), abs=0.15)  # contact radius


def test_a_strip_around_a_cylinder_holds_by_the_capstan_equation():
    radius, thickness, friction = 10.0, 0.2, 0.3
    flat = bar((1.0, thickness, 1.0), (40, 1, 1))
    angle = 0.5 * np.pi * (1.0 - flat.nodes[:, 0])
    at = radius + 0.5 * thickness + flat.nodes[:, 1]
    mesh = Mesh(
        np.stack([at * np.cos(angle), at * np.sin(angle), flat.nodes[:, 2]], axis=1), flat.hexes, flat.materials
    )
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    inside = mesh.nodes_where(np.hypot(x, y) < radius + 1e-6)
    held, pulled = mesh.nodes_where(np.abs(x) < 1e-9), mesh.nodes_where(np.abs(y) < 1e-9)
    supports = Supports.none(len(x)).with_prescribed(held, "xy").with_prescribed(np.arange(len(x)), "z")
    quads = mesh.surface()
    load = np.zeros_like(mesh.nodes)
    load[:, 1] = -1.0 * face_shares(mesh.nodes, quads[np.isin(quads, pulled).all(axis=1)])
    cylinder = Obstacle(ObstacleShape.CYLINDER, (0.0, 0.0, 5.0), inside, (0.0, 0.0, 2.0), radius, friction)
    solver = Solver(
        mesh,
        [Linear("any", 1e3, 0.0)],
        supports,
        settings=SolverSettings(window=30, step_limit=0.5),
        surroundings=Surroundings(obstacles=(cylinder,)),
    )
    found = solver.solve(load=load, tolerance=1e-5, max_iterations=6000)
    (contact,) = found.contacts
    assert found.converged
    tension = found.reaction[held, 0].sum()
    assert abs(tension) == pytest.approx(np.exp(-friction * 0.5 * np.pi), rel=0.02)
    np.testing.assert_allclose(
        found.reaction.sum(axis=0)[:2] + contact.total[:2] + load.sum(axis=0)[:2], 0.0, atol=1e-4
    )


def test_a_beam_pulled_onto_a_cylinder_lies_on_it():
    mesh = bar((40.0, 4.0, 4.0), (32, 3, 3))
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    supports = Supports.none(len(x)).with_prescribed(mesh.nodes_where(x == 0.0))
    bottom, end = mesh.nodes_where(y == y.min()), mesh.nodes_where(x == 40.0)
    cylinder = Obstacle(ObstacleShape.CYLINDER, (20.0, -10.0, 0.0), bottom, (0.0, 0.0, 1.0), radius=7.5)
    load = np.zeros_like(mesh.nodes)
    load[end, 1] = -0.5 / len(end)
    solver = Solver(
        mesh,
        [Linear("any", 5.0, 0.3)],
        supports,
        settings=SolverSettings(window=20, step_limit=1.0),
        surroundings=Surroundings(obstacles=(cylinder,)),
    )
    found = solver.solve(load=load, tolerance=1e-6, max_iterations=4000)
    (contact,) = found.contacts
    assert found.converged
    assert contact.total[1] > 0.5  # the end is a lever: the cylinder carries more than the load
    np.testing.assert_allclose(found.reaction.sum(axis=0) + contact.total + load.sum(axis=0), 0.0, atol=1e-5)
    at = mesh.nodes + found.displacement
    assert np.hypot(at[bottom, 0] - 20.0, at[bottom, 1] + 10.0).min() > 7.5 - 1e-6
    normal = at[contact.nodes] - [20.0, -10.0, 0.0]
    normal[:, 2] = 0.0
    np.testing.assert_allclose(np.cross(normal, contact.force), 0.0, atol=1e-6)  # no friction: forces stand on it


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 0.0}, "radius above 0"),
        ({"friction": -0.1}, "friction coefficient of 0 or more"),
        ({"axis": (0.0, 0.0, 0.0)}, "axis other than 0"),
        ({"nodes": np.zeros(0, dtype=np.int32)}, "nodes that may touch"),
    ],
    ids=["radius", "friction", "axis", "nodes"],
)
def test_impossible_obstacles_are_refused(change, message):
    good = {"shape": ObstacleShape.SPHERE, "point": (0.0, 0.0, 0.0), "nodes": np.array([1]), "radius": 1.0}
    with pytest.raises(GdfeError, match=message):
        Obstacle(**{**good, **change})
