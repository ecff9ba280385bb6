# SPDX-License-Identifier: Apache-2.0
"""Loads that follow the body, weight, several cables: against closed forms and independent integrations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softgrip_model.finger import FRICTIONLESS
from softgrip_model.gdfe import (
    Acts,
    CableDrive,
    FollowerPatch,
    GdfeError,
    Linear,
    Mesh,
    RoutedCable,
    RoutingPoint,
    Solver,
    SolverSettings,
    Supports,
    Surroundings,
    _core,
    bar,
)
from softgrip_model.gdfe.surroundings import face_shares, gravity


def quads_where(mesh, chosen):
    """Outer faces whose four corners are chosen."""
    quads = mesh.surface()
    return quads[chosen[quads].all(axis=1)]


def skewed(seed=3, amount=0.15):
    mesh = bar((3.0, 2.0, 2.0), (3, 2, 2))
    moved = mesh.nodes + amount * np.random.default_rng(seed).uniform(-1, 1, mesh.nodes.shape)
    return Mesh(moved, mesh.hexes, mesh.materials)


def volume(nodes, hexes):
    return sum(_core.make_element(nodes[corners]).volume for corners in hexes)


def load_of(mesh, pressure, displacement):
    """Forces of a pressure on the whole surface: the difference it makes to the reactions of a mesh held everywhere."""
    held = Supports.none(len(mesh.nodes)).with_prescribed(np.arange(len(mesh.nodes)))
    solver = Solver(mesh, [Linear("any", 1.0, 0.3)], held, surroundings=Surroundings(pressed=(mesh.surface(),)))
    with_it, without = (
        solver.solve(displacement, acts=Acts(pressures=(p,)), max_iterations=0).reaction for p in (pressure, 0.0)
    )
    return without - with_it


def test_pressure_on_a_closed_surface_is_in_balance_and_works_against_the_volume():
    mesh = skewed()
    rng = np.random.default_rng(5)
    at, direction = 0.2 * rng.uniform(-1, 1, mesh.nodes.shape), rng.uniform(-1, 1, mesh.nodes.shape)
    load = load_of(mesh, 0.7, at)
    here = mesh.nodes + at
    np.testing.assert_allclose(load.sum(axis=0), 0.0, atol=1e-13)
    np.testing.assert_allclose(np.cross(here, load).sum(axis=0), 0.0, atol=1e-12)
    h = 1e-5
    growth = (volume(here + h * direction, mesh.hexes) - volume(here - h * direction, mesh.hexes)) / (2 * h)
    assert np.sum(load * direction) == pytest.approx(-0.7 * growth, rel=1e-7)


def quarter_ring(inner, outer, around, through):
    """Bent bar: x of the bar -> angle, y -> radius, z stays."""
    flat = bar((1.0, outer - inner, 1.0), (around, through, 1))
    angle = 0.5 * np.pi * (1.0 - flat.nodes[:, 0])
    radius = flat.nodes[:, 1] + 0.5 * (inner + outer)
    nodes = np.stack([radius * np.cos(angle), radius * np.sin(angle), flat.nodes[:, 2]], axis=1)
    return Mesh(nodes, flat.hexes, flat.materials), flat.nodes[:, 1] < -0.499 * (outer - inner)


def test_a_thick_tube_under_pressure_widens_as_lame_says():
    inner, outer, modulus, poisson, pressure = 1.0, 2.0, 10.0, 0.3, 1e-3
    mesh, inside = quarter_ring(inner, outer, 24, 16)
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    supports = Supports.none(len(x)).with_prescribed(np.arange(len(x)), "z")
    supports = supports.with_prescribed(mesh.nodes_where(x < 1e-9), "x").with_prescribed(
        mesh.nodes_where(y < 1e-9), "y"
    )
    around = Surroundings(pressed=(quads_where(mesh, inside),))
    solver = Solver(mesh, [Linear("any", modulus, poisson)], supports, surroundings=around)
    found = solver.solve(acts=Acts(pressures=(pressure,)), tolerance=1e-7)
    a = pressure * inner**2 / (outer**2 - inner**2)
    b = pressure * inner**2 * outer**2 / (outer**2 - inner**2)
    expected = (1 + poisson) / modulus * ((1 - 2 * poisson) * a * inner + b / inner)  # plane strain
    widened = np.linalg.norm((mesh.nodes + found.displacement)[inside, :2], axis=1) - inner
    assert found.converged
    np.testing.assert_allclose(widened, expected, rtol=0.01)


def test_a_column_sags_under_its_weight_and_stands_on_it():
    length, modulus, density, g = 10.0, 4.0, 0.02, 0.5
    mesh = bar((length, 2.0, 2.0), (10, 2, 2))
    base = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    solver = Solver(mesh, [Linear("any", modulus, 0.0)], Supports.none(len(mesh.nodes)).with_prescribed(base))
    found = solver.solve(load=gravity(mesh, (density,), (-g, 0.0, 0.0)), tolerance=1e-9)
    weight = density * g * length * 4.0
    assert found.reaction[:, 0].sum() == pytest.approx(weight, rel=1e-7)
    top = found.displacement[mesh.nodes[:, 0] == length, 0]
    np.testing.assert_allclose(top, -density * g * length**2 / (2 * modulus), rtol=1e-5)


def test_the_weight_of_any_mesh_is_its_mass_at_its_centre():
    mesh = skewed()
    weight = gravity(mesh, (2.0,), (0.0, -9.0, 0.0))
    assert weight.sum() == pytest.approx(-18.0 * volume(mesh.nodes, mesh.hexes), rel=1e-12)
    with pytest.raises(GdfeError, match="density of 0 or more for 1 materials"):
        gravity(mesh, (), (0.0, -9.0, 0.0))


def test_an_even_load_is_shared_by_area():
    # nodes of an evenly divided face: corners a quarter, edges a half, inside a whole cell
    mesh = bar((1.0, 2.0, 2.0), (1, 2, 2))
    shares = face_shares(mesh.nodes, quads_where(mesh, mesh.nodes[:, 0] == 1.0))
    assert sorted(shares[shares > 0.0]) == pytest.approx([1 / 16] * 4 + [1 / 8] * 4 + [1 / 4])


def follower_elastica(force, stiffness, length):
    """Tip of a cantilever under a tip force that stays square to it; integrated from the tip, where all is known."""

    def slope(s, state):
        x, _, angle = state
        return [np.cos(angle), np.sin(angle), force * x / stiffness]

    x, y, angle = solve_ivp(slope, (0.0, length), [0.0, 0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    # seen from the base: its tangent along -x there, so that the tip lies at
    c, s = np.cos(angle), np.sin(angle)
    return c * x + s * y, -s * x + c * y


def test_a_force_that_turns_with_the_tip_bends_a_beam_as_the_elastica():
    length, height, modulus, force = 60.0, 4.0, 100.0, 1.2
    mesh = bar((length, height, 4.0), (90, 6, 1))
    x = mesh.nodes[:, 0]
    supports = Supports.none(len(x)).with_prescribed(mesh.nodes_where(x == 0.0))
    patch = FollowerPatch.of_faces(mesh, quads_where(mesh, x == length))
    solver = Solver(
        mesh,
        [Linear("any", modulus, 0.0)],
        supports,
        settings=SolverSettings(window=30, step_limit=2.0),
        surroundings=Surroundings(followers=(patch,)),
    )
    start = None
    for share in (0.25, 0.5, 0.75, 1.0):
        acts = Acts(follower_forces=((0.0, -share * force, 0.0),))
        found = solver.solve(acts=acts, start=start, tolerance=1e-6, max_iterations=4000)
        start = found.state
    tip = (mesh.nodes + found.displacement)[x == length].mean(axis=0)
    reach, drop = follower_elastica(force, modulus * 4.0 * height**3 / 12.0, length)
    assert found.converged
    assert abs(drop) > 0.4 * length
    assert tip[0] == pytest.approx(abs(reach), abs=0.02 * length)
    assert -tip[1] == pytest.approx(abs(drop), abs=0.02 * length)


def two_cables(upper, lower):
    mesh = bar((40.0, 8.0, 8.0), (16, 4, 4))
    base = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    cables = []
    for y in (4.0, -4.0):
        points = [RoutingPoint((0.0, y, 0.0), np.zeros(0, dtype=np.int32), np.zeros(0))]
        for x in np.arange(10.0, 41.0, 10.0):
            nodes = mesh.nodes_where((mesh.nodes[:, 0] == x) & (mesh.nodes[:, 1] == y))
            points.append(RoutingPoint((x, y, 0.0), nodes, np.full(len(nodes), 1.0 / len(nodes))))
        cables.append(RoutedCable(tuple(points), FRICTIONLESS))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(base)
    solver = Solver(mesh, [Linear("any", 1.0, 0.0)], supports, cables, SolverSettings(window=30))
    found = solver.solve(drives=[upper, lower], tolerance=1e-8, length_tolerance=1e-7, max_iterations=4000)
    assert found.converged
    end = face_shares(mesh.nodes, quads_where(mesh, mesh.nodes[:, 0] == 40.0))
    return found, end @ found.displacement


@pytest.mark.parametrize("drive", [CableDrive(0.3, by_length=False), CableDrive(0.1)], ids=["tension", "length"])
def test_two_opposed_cables_cancel_and_shorten_the_bar(drive):
    found, tip = two_cables(drive, drive)
    tension = found.tension[0][0]
    assert tension == pytest.approx(found.tension[1][0], rel=1e-6)
    assert abs(tip[1]) < 1e-4
    assert -tip[0] == pytest.approx(2.0 * tension / 1.6, rel=5e-3)  # E A / L = 1.6 N/mm


def test_a_cable_by_length_and_one_by_tension_act_together():
    by_tension, tip = two_cables(CableDrive(0.2, by_length=False), CableDrive(1.0, by_length=False))
    mixed, other = two_cables(CableDrive(0.2, by_length=False), CableDrive(by_tension.shortening[1]))
    assert mixed.tension[1][0] == pytest.approx(1.0, rel=1e-3)
    np.testing.assert_allclose(other, tip, atol=1e-3)
    assert tip[1] < -1.0


def test_acts_that_do_not_fit_the_surroundings_are_refused():
    mesh = bar((1.0, 1.0, 1.0), (1, 1, 1))
    held = Supports.none(8).with_prescribed(np.arange(8))
    solver = Solver(mesh, [Linear("any", 1.0, 0.3)], held, surroundings=Surroundings(pressed=(mesh.surface(),)))
    with pytest.raises(GdfeError, match="expected 1 finite pressures"):
        solver.solve(acts=Acts())
    with pytest.raises(GdfeError, match="expected 1 finite pressures"):
        solver.solve(acts=Acts(pressures=(np.nan,)))
