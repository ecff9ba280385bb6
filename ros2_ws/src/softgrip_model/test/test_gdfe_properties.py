# SPDX-License-Identifier: Apache-2.0
"""Properties of the solver's parts: exact splits and gradients, materials, cable, determinism, refusals."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from softgrip_model.finger import FRICTIONLESS
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.friction.laws import Law as FrictionName
from softgrip_model.gdfe import (
    CableDrive,
    ConstitutiveLaw,
    GdfeError,
    Linear,
    Mesh,
    Metric,
    Ordering,
    RoutedCable,
    RoutingPoint,
    Solver,
    SolverSettings,
    State,
    Supports,
    VolumeShape,
    _core,
    bar,
)
from softgrip_model.gdfe.march import Loading, march
from softgrip_model.gdfe.materials import Ogden, cheetah, cheetah_ogden, neo_hookean, ninjaflex
from softgrip_model.gdfe.mesh_file import read_mesh, write_mesh
from softgrip_model.gdfe.rigid import check_held


def has_metis():
    """Whether METIS was there when the core was built: CMake does without."""
    mesh = bar((2.0, 1.0, 1.0), (2, 1, 1))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(mesh.nodes_where(mesh.nodes[:, 0] == 0.0))
    try:
        Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=SolverSettings(ordering=Ordering.METIS)).solve()
    except (GdfeError, RuntimeError) as error:
        if "no METIS" not in str(error):
            raise
        return False
    return True


needs_metis = pytest.mark.skipif(not has_metis(), reason="this build has no METIS")
ORDERINGS = (Ordering.AMD, pytest.param(Ordering.METIS, marks=needs_metis))


def skewed(seed=3, amount=0.15):
    mesh = bar((3.0, 2.0, 2.0), (3, 2, 2))
    moved = mesh.nodes + amount * np.random.default_rng(seed).uniform(-1, 1, mesh.nodes.shape)
    return Mesh(moved, mesh.hexes, mesh.materials)


def test_the_laplacian_is_exact_on_affine_motions_of_any_hexahedron():
    mesh = skewed()
    corners = mesh.nodes[mesh.hexes[0]]
    element = _core.make_element(corners)
    np.testing.assert_allclose(corners.T @ element.gradient, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(element.laplacian @ corners, element.volume * element.gradient, atol=1e-12)
    np.testing.assert_allclose(element.laplacian.sum(axis=0), 0.0, atol=1e-12)


def test_corner_forces_at_small_strain_are_those_of_the_laplacian():
    # nu = 0 leaves no volume term: forces are 2 mu K (V - R X), and R = 1 for a symmetric gradient
    mesh = skewed()
    mesh = Mesh(mesh.nodes[mesh.hexes[0]], np.arange(8).reshape(1, 8), np.zeros(1))
    solver = Solver(mesh, [Linear("soft", 3.0, 0.0)], Supports.none(8).with_prescribed(np.arange(8)))
    rng = np.random.default_rng(1)
    stretch = rng.uniform(-1, 1, (3, 3))
    hourglass = rng.uniform(-1, 1, (8, 3))
    element = _core.make_element(mesh.nodes)
    hourglass -= mesh.nodes @ (element.gradient.T @ hourglass)
    moved = 1e-5 * (mesh.nodes @ (stretch + stretch.T) + hourglass)
    expected = 3.0 * element.laplacian @ moved
    np.testing.assert_allclose(solver.internal_force(moved), expected, atol=1e-4 * np.abs(expected).max())


def test_rigorous_forces_are_the_gradient_of_the_energy():
    mesh = skewed(amount=0.1)
    material = Ogden("two terms", (1.3, 0.4), (2.0, -1.5), 0.4)
    everywhere = np.arange(len(mesh.nodes), dtype=np.int32)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(everywhere)
    solver = Solver(mesh, [material], supports, settings=SolverSettings(law=ConstitutiveLaw.RIGOROUS))
    rng = np.random.default_rng(2)
    at, direction = 0.05 * rng.uniform(-1, 1, mesh.nodes.shape), rng.uniform(-1, 1, mesh.nodes.shape)
    h = 1e-5
    slope = (solver.energy(at + h * direction) - solver.energy(at - h * direction)) / (2 * h)
    assert np.sum(solver.internal_force(at) * direction) == pytest.approx(slope, rel=1e-7)


def drawn_block(material, law=ConstitutiveLaw.RIGOROUS, **settings):
    """Return a solver of a bar of 2 x 1 x 1 whose sides are free, and what moves its end by a stretch."""
    mesh = bar((2.0, 1.0, 1.0), (4, 2, 2))
    x, y, z = mesh.nodes.T
    end = mesh.nodes_where(x == x.max())
    supports = Supports.none(len(mesh.nodes)).with_prescribed(end, "x")
    for axis, place in zip("xyz", (x, y, z), strict=True):
        supports = supports.with_prescribed(mesh.nodes_where(place == place.min()), axis)
    moved = np.zeros_like(mesh.nodes)
    moved[end, 0] = 2.0
    return Solver(mesh, [material], supports, settings=SolverSettings(law=law, **settings)), moved


def test_the_rigorous_law_needs_few_iterations_with_its_own_tangent():
    """At nu = 0.499, where the constant matrix alone needs many."""
    solver, moved = drawn_block(neo_hookean("rubber", 1.0, 0.499))
    found = solver.solve(0.02 * moved, tolerance=1e-8)
    constant, _ = drawn_block(neo_hookean("rubber", 1.0, 0.499), max_tangent_unknowns=0)
    slow = constant.solve(0.02 * moved, tolerance=1e-8)
    assert found.converged
    assert found.iterations <= 30  # 20 of them by the constant matrix: the first tangent is not definite
    assert found.unstable_modes == 0
    assert slow.iterations > 3 * found.iterations
    assert slow.unstable_modes is None
    np.testing.assert_allclose(found.displacement, slow.displacement, atol=1e-7)


def test_an_equilibrium_that_is_not_stable_is_found_out():
    """A folded bar, found by the constant matrix: its forces balance, its energy is ten times that of the drawn one."""
    material = neo_hookean("rubber", 1.0, 0.45)
    constant, moved = drawn_block(material, max_tangent_unknowns=0)
    folded = constant.solve(0.3 * moved, tolerance=1e-8)
    straight = march(constant, lambda share: Loading(0.3 * share * moved), 4, tolerance=1e-8).last
    assert folded.converged
    assert constant.energy(folded.displacement) > 5.0 * constant.energy(straight.displacement)
    solver, _ = drawn_block(material)
    assert solver.solve(0.3 * moved, start=folded.state, tolerance=1e-8).unstable_modes == 1
    assert solver.solve(0.3 * moved, start=straight.state, tolerance=1e-8).unstable_modes == 0


def test_a_march_does_not_take_an_unstable_equilibrium():
    solver, moved = drawn_block(neo_hookean("rubber", 1.0, 0.45))
    found = march(solver, lambda share: Loading(0.3 * share * moved), 1, tolerance=1e-8)
    assert found.completed
    end = moved[:, 0] > 0.0
    expected = float(neo_hookean("rubber", 1.0, 0.45).uniaxial_stress(np.array(1.3)))
    assert found.last.reaction[end, 0].sum() == pytest.approx(expected, rel=1e-6)
    assert found.last.unstable_modes == 0


@pytest.mark.parametrize("law", [ConstitutiveLaw.CALIBRATED, ConstitutiveLaw.RIGOROUS])
def test_forces_turn_with_the_body(law):
    mesh = skewed()
    supports = Supports.none(len(mesh.nodes)).with_prescribed(np.arange(len(mesh.nodes)))
    solver = Solver(mesh, [neo_hookean("rubber", 2.0, 0.4)], supports, settings=SolverSettings(law=law))
    at = mesh.nodes + 0.1 * np.random.default_rng(4).uniform(-1, 1, mesh.nodes.shape)
    c, s = np.cos(2.0), np.sin(2.0)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    before, after = solver.internal_force(at - mesh.nodes), solver.internal_force(at @ turn.T - mesh.nodes)
    np.testing.assert_allclose(after, before @ turn.T, atol=1e-9)


def drawn_bar_with_free_sides(material, stretch, **settings):
    """Return the nominal stress of a bar of 2 x 1 x 1, a quarter of a longer one, its sides free."""
    solver, moved = drawn_block(material, **{"law": ConstitutiveLaw.CALIBRATED, **settings})
    drawn = march(solver, lambda share: Loading(share * (stretch - 1.0) * moved), increments=4, tolerance=1e-8).last
    assert drawn.converged
    return drawn.reaction[moved[:, 0] > 0.0, 0].sum()


@pytest.mark.parametrize("shape", list(VolumeShape))
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49])
@pytest.mark.parametrize("make", [ninjaflex, cheetah], ids=lambda make: make.__name__)
def test_a_drawn_bar_answers_with_the_measured_stress_whatever_poissons_ratio(make, poisson, shape):
    material = make(poisson)
    for stretch in (1.001, 1.02, 1.1, 1.4):
        measured = float(material.nominal_stress(np.array(stretch)))
        assert drawn_bar_with_free_sides(material, stretch, volume_shape=shape) == pytest.approx(measured, rel=1e-6)


@pytest.mark.parametrize("material", [neo_hookean("rubber", 1.0, 0.3), cheetah_ogden(0.45)], ids=lambda m: m.name)
def test_a_drawn_bar_answers_as_by_the_rigorous_law(material):
    for stretch in (1.02, 1.1, 1.2):
        rigorous = drawn_bar_with_free_sides(material, stretch, law=ConstitutiveLaw.RIGOROUS)
        assert float(material.uniaxial_stress(np.array(stretch))) == pytest.approx(rigorous, rel=1e-6)
        assert drawn_bar_with_free_sides(material, stretch) == pytest.approx(rigorous, rel=1e-6)


def test_settings_take_names_and_refuse_unknown_ones():
    assert SolverSettings(law="rigorous") == SolverSettings(law=ConstitutiveLaw.RIGOROUS)
    with pytest.raises(ValueError, match="exact"):
        SolverSettings(law="exact")


def solved_bar(**settings):
    mesh = bar((8.0, 2.0, 2.0), (8, 2, 2))
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 8.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right, "yz").with_tied(right, "x")
    solver = Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=SolverSettings(**settings))
    prescribed = np.zeros_like(mesh.nodes)
    prescribed[right, 1] = 2.0
    return solver.solve(prescribed, tolerance=1e-9, max_iterations=5000)


@pytest.mark.parametrize(
    "settings",
    [
        {"single_precision_factor": False},
        pytest.param({"ordering": Ordering.METIS}, marks=needs_metis),
        {"threads": 3},
        {"window": 0},
        {"window": 25},
    ],
    ids=str,
)
def test_precision_ordering_threads_and_memory_do_not_change_the_answer(settings):
    usual, other = solved_bar(), solved_bar(**settings)
    assert usual.converged
    assert other.converged
    np.testing.assert_allclose(other.displacement, usual.displacement, atol=1e-6)


@pytest.mark.parametrize("shape", [(6, 6, 6), (30, 2, 2)], ids=["cube", "slender"])
def test_every_elimination_order_undoes_the_same_matrix(shape):
    mesh = bar(tuple(map(float, shape)), shape)
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == shape[0])
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)
    prescribed = np.zeros_like(mesh.nodes)
    prescribed[right, 0] = 0.1 * shape[0]
    found = []
    for ordering in (Ordering.AMD, Ordering.AUTOMATIC, *((Ordering.METIS,) if has_metis() else ())):
        for threads in (1, 2, 5):
            settings = SolverSettings(ordering=ordering, threads=threads, single_precision_factor=False)
            solver = Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=settings)
            found.append(solver.solve(prescribed, tolerance=1e-10))
            # plane after plane, each coupled in full with the next, is an order, too
            plane = (shape[1] + 1) * (shape[2] + 1)
            assert solver.matrix_entries <= (shape[0] - 1) * (plane * (plane + 1) // 2 + plane**2)
    for one in found[1:]:
        assert abs(one.iterations - found[0].iterations) <= 1  # a factor of something else would take others
        np.testing.assert_allclose(one.displacement, found[0].displacement, atol=1e-8)


@pytest.mark.parametrize("ordering", ORDERINGS)
def test_a_block_is_not_eliminated_plane_after_plane(ordering):
    mesh = bar((12.0, 12.0, 12.0), (12, 12, 12))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(mesh.nodes_where(mesh.nodes[:, 0] == 0.0))
    solver = Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=SolverSettings(ordering=ordering))
    assert solver.matrix_entries < 0.7 * 12 * 13**4  # every unknown with all of one plane


@pytest.mark.parametrize("axes", ["x", "xyz"])
def test_where_the_matrix_is_the_tangent_a_plain_iteration_goes_straight_there(axes):
    """Without Poisson's effect the law's energy is mu |F - R|^2: small turns apart, that of the constant matrix."""
    mesh = bar((8.0, 4.0, 4.0), (8, 4, 4))
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 8.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left)
    for axis in axes:
        supports = supports.with_tied(right, axis)
    load = np.zeros_like(mesh.nodes)
    load[right, 0] = 1e-3
    found = Solver(mesh, [Linear("any", 1.0, 0.0)], supports, settings=SolverSettings(window=0)).solve(load=load)
    assert found.converged
    assert found.iterations <= 10


@pytest.mark.parametrize("threads", [1, 2])
def test_the_same_solve_gives_the_same_bits(threads):
    first, second = solved_bar(threads=threads), solved_bar(threads=threads)
    assert (first.displacement == second.displacement).all()
    assert first.history == second.history


@needs_metis
def test_two_matrices_are_made_at_once_with_the_same_bits_every_time():
    mesh = bar((6.0, 6.0, 6.0), (6, 6, 6))
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 6.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_tied(right, "x")
    load = np.zeros_like(mesh.nodes)
    load[right, 1] = 1e-2
    found = []
    for _ in range(3):
        settings = SolverSettings(ordering=Ordering.METIS, threads=2)
        found.append(Solver(mesh, [Linear("any", 5.0, 0.3)], supports, settings=settings).solve(load=load))
    assert found[0].converged
    assert all(other.history == found[0].history for other in found[1:])


THREADS_OF_A_PROCESS = """
import os
from softgrip_model.gdfe.thesis_bars import five_materials
from softgrip_model.gdfe import Solver, SolverSettings
case, materials = five_materials()
before = len(os.listdir("/proc/self/task"))
Solver(case.mesh, materials, case.supports, settings=SolverSettings(threads=1))
print(len(os.listdir("/proc/self/task")) - before)
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists() or os.cpu_count() == 1, reason="needs two processors")
def test_a_solver_of_one_thread_starts_none():
    free = {name: value for name, value in os.environ.items() if not name.startswith("OMP_")}
    done = subprocess.run(
        [sys.executable, "-c", THREADS_OF_A_PROCESS], env=free, capture_output=True, text=True, check=True, timeout=60
    )
    assert int(done.stdout) == 0


def test_reactions_balance_and_forces_of_a_solved_mesh_vanish_inside():
    found = solved_bar()
    np.testing.assert_allclose(found.reaction[:, 1].sum(), 0.0, atol=1e-6 * np.abs(found.reaction).max())


def test_a_step_that_does_not_converge_says_so():
    mesh = bar((8.0, 2.0, 2.0), (8, 2, 2))
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 8.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)
    prescribed = np.zeros_like(mesh.nodes)
    prescribed[right, 1] = 2.0
    found = Solver(mesh, [Linear("any", 5.0, 0.3)], supports).solve(prescribed, max_iterations=3)
    assert not found.converged
    assert found.iterations == 3
    assert found.residual > 1e-6


@pytest.mark.parametrize("shape", list(VolumeShape))
def test_an_inverted_start_is_survived(shape):
    mesh = bar((4.0, 2.0, 2.0), (4, 2, 2))
    left = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left)
    solver = Solver(
        mesh, [Linear("any", 5.0, 0.3)], supports, settings=SolverSettings(volume_shape=shape, step_limit=0.5)
    )
    pushed = np.zeros_like(mesh.nodes)
    pushed[np.argmin(np.linalg.norm(mesh.nodes - [2.0, 0.0, 0.0], axis=1)), 0] = 1.4  # through its neighbours
    found = solver.solve(start=State(pushed), force_floor=1.0, max_iterations=4000)
    assert found.converged
    assert np.abs(found.displacement).max() < 1e-3


ROUTED = tuple(np.arange(10.0, 81.0, 10.0))


def cable_beam(friction, *, by_length):
    mesh = bar((80.0, 10.0, 10.0), (64, 5, 5))
    left = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    points = [
        RoutingPoint((x, -5.0, 0.0), nodes, np.full(len(nodes), 1.0 / len(nodes)))
        for x in ROUTED
        if len(nodes := mesh.nodes_where((mesh.nodes[:, 0] == x) & (mesh.nodes[:, 1] == -5.0)))
    ]
    base = RoutingPoint((0.0, -5.0, 0.0), np.zeros(0, dtype=np.int32), np.zeros(0))
    cable = RoutedCable((base, *points), friction)
    solver = Solver(
        mesh,
        [Linear("MPa", 1.0, 0.3)],
        Supports.none(len(mesh.nodes)).with_prescribed(left),
        [cable],
        SolverSettings(window=30),
    )
    return solver.solve(drives=[by_length], tolerance=1e-6, max_iterations=4000), mesh


def test_a_cantilever_under_its_cable_bends_as_the_arc_says():
    # E = 1 MPa, 80 x 10 x 10 mm, 1 N along the lower edge: curvature T e / E I, all along
    curvature = 1.0 * 5.0 / (1.0 * 10.0**4 / 12.0)
    found, mesh = cable_beam(FRICTIONLESS, by_length=CableDrive(1.0, by_length=False))
    tip = found.displacement[mesh.nodes[:, 0] == 80.0, 1].mean()
    assert found.converged
    assert tip == pytest.approx(-(1.0 - np.cos(80.0 * curvature)) / curvature, rel=0.03)


def test_length_and_tension_are_two_sides_of_one_equilibrium():
    by_tension, _ = cable_beam(FRICTIONLESS, by_length=CableDrive(0.5, by_length=False))
    by_length, _ = cable_beam(FRICTIONLESS, by_length=CableDrive(by_tension.shortening[0]))
    assert by_length.converged
    assert by_length.tension[0][0] == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(by_length.displacement, by_tension.displacement, atol=5e-3)


def test_friction_takes_tension_away_by_the_wrap_angles():
    mu = 0.3
    found, mesh = cable_beam(FrictionLaw(FrictionName.CAPSTAN, (mu,), 1.0), by_length=CableDrive(1.0, by_length=False))
    at = mesh.nodes + found.displacement
    line = [np.array([0.0, -5.0, 0.0])]
    line += [at[(mesh.nodes[:, 0] == x) & (mesh.nodes[:, 1] == -5.0)].mean(axis=0) for x in ROUTED]
    spans = [np.array([1.0, 0.0, 0.0]), *np.diff(line, axis=0)]
    angles = [
        np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)) for a, b in itertools.pairwise(spans)
    ]
    assert found.converged
    assert found.tension[0][-1] == pytest.approx(np.exp(-mu * sum(angles)), rel=1e-6)


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "inp", "msh"])
def test_a_mesh_goes_through_a_file_and_back(suffix, tmp_path):
    mesh = skewed()
    write_mesh(tmp_path / f"body.{suffix}", mesh)
    read, _ = read_mesh(tmp_path / f"body.{suffix}")
    np.testing.assert_allclose(read.nodes, mesh.nodes, rtol=1e-12)
    assert (read.hexes == mesh.hexes).all()


def test_materials_go_through_a_file_and_back(tmp_path):
    mesh = bar((4.0, 2.0, 2.0), (4, 2, 2), 2)
    write_mesh(tmp_path / "bar.vtu", mesh)
    read, _ = read_mesh(tmp_path / "bar.vtu")
    assert read.digest == mesh.digest


def test_bad_mesh_files_are_refused(tmp_path):
    mesh = bar((2.0, 1.0, 1.0), (2, 1, 1))
    lonely = np.vstack([mesh.nodes, [[9.0, 9.0, 9.0]]])
    meshio.Mesh(lonely, [("hexahedron", mesh.hexes)]).write(tmp_path / "lonely.vtu")
    with pytest.raises(GdfeError, match="node 12 belongs to no element"):
        read_mesh(tmp_path / "lonely.vtu")
    inverted = mesh.hexes[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    meshio.Mesh(mesh.nodes, [("hexahedron", inverted)]).write(tmp_path / "inverted.vtu")
    with pytest.raises(GdfeError, match="element 0 is inverted"):
        read_mesh(tmp_path / "inverted.vtu")
    meshio.Mesh(mesh.nodes, [("tetra", mesh.hexes[:, :4])]).write(tmp_path / "tetra.vtu")
    with pytest.raises(GdfeError, match="expected hexahedra of 8 corners, found \\['tetra'\\]"):
        read_mesh(tmp_path / "tetra.vtu")
    (tmp_path / "text.vtu").write_text("no mesh", encoding="utf-8")
    for name in ("text.vtu", "missing.vtu", "mesh.docx"):
        with pytest.raises(GdfeError, match="cannot be read as a mesh"):
            read_mesh(tmp_path / name)


def test_a_march_that_stops_keeps_the_last_converged_state_and_says_where():
    mesh = bar((8.0, 2.0, 2.0), (8, 2, 2))
    left, right = mesh.nodes_where(mesh.nodes[:, 0] == 0.0), mesh.nodes_where(mesh.nodes[:, 0] == 8.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)

    def loading(share):  # beyond 60 % the end would have to be where nothing can be
        moved = np.zeros_like(mesh.nodes)
        moved[right, 1] = share if share < 0.6 else np.nan
        return Loading(moved)

    solver = Solver(mesh, [Linear("any", 5.0, 0.3)], supports)
    found = march(solver, loading, 4, halvings=2)
    assert not found.completed
    assert found.shares[-1] == pytest.approx(0.5625)
    assert found.last.converged
    np.testing.assert_allclose(found.last.displacement[right, 1], 0.5625)
    assert "kept: 56.2 %" in found.reason


def test_bad_meshes_are_refused_with_element_and_reason():
    good = bar((2.0, 1.0, 1.0), (2, 1, 1))
    inverted = good.hexes.copy()
    inverted[1] = inverted[1][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(GdfeError, match="element 1 is inverted"):
        Mesh(good.nodes, inverted, good.materials)
    flat = good.nodes.copy()
    flat[:, 2] = 0.0
    with pytest.raises(GdfeError, match="element 0 is degenerate"):
        Mesh(flat, good.hexes, good.materials)
    with pytest.raises(GdfeError, match="node 12 belongs to no element"):
        Mesh(np.vstack([good.nodes, [[9.0, 9.0, 9.0]]]), good.hexes, good.materials)
    with pytest.raises(GdfeError, match="element 0 has material 0"):
        Solver(good, [], Supports.none(12))


@pytest.mark.parametrize(
    ("axes", "motion"), [("", "along|about"), ("x", "along|about"), ("xyz", None)], ids=["free", "sliding", "held"]
)
def test_supports_that_leave_a_rigid_motion_are_refused(axes, motion):
    mesh = bar((2.0, 1.0, 1.0), (2, 1, 1))
    face = mesh.nodes_where(mesh.nodes[:, 0] == 0.0)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(face, axes)
    if motion is None:
        check_held(mesh, supports)
    else:
        with pytest.raises(GdfeError, match=motion):
            check_held(mesh, supports)


def test_one_held_node_still_lets_the_body_turn():
    mesh = bar((2.0, 1.0, 1.0), (2, 1, 1))
    with pytest.raises(GdfeError, match="about"):
        check_held(mesh, Supports.none(len(mesh.nodes)).with_prescribed(np.array([0])))


def test_metrics_agree_on_affine_motions():
    results = [solved_bar(metric=metric) for metric in Metric]
    assert results[1].reaction[:, 1].max() > results[0].reaction[:, 1].max()  # the thesis' N is stiffer in hourglass
