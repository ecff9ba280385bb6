# SPDX-License-Identifier: Apache-2.0
"""A printed solid as hexahedra: cutting tetrahedra, finding the finger in it, closing it; gmsh is scripted here."""

import itertools
import json
import stat
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from softgrip_model.commands import simulate
from softgrip_model.finger import Finger
from softgrip_model.gdfe import GdfeError, Mesh, bar
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, mesh_finger
from softgrip_model.gdfe.solid_mesh import SolidFinger, cut_into_hexahedra, mesh_solid, slices, tetrahedra_of
from softgrip_model.profile import load, shipped_directory

POWER = load(shipped_directory() / "power.yaml")
FINGER = Finger.from_profile(POWER, "index")
#: The six tetrahedra of Kuhn's cut of a hexahedron, along its diagonal from corner 0 to corner 6: neighbours agree.
KUHN = np.array([[0, *way, 6] for way in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))])


def tetrahedra(mesh: Mesh) -> np.ndarray:
    return mesh.hexes[:, KUHN].reshape(-1, 4)


def volumes(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    return np.linalg.det(nodes[cells[:, 1:]] - nodes[cells[:, :1]]) / 6.0


def printed_like() -> Mesh:
    """The profile's own mesh with the joint at the groove's apex, as parts are printed."""
    return mesh_finger(FINGER, RESOLUTIONS["coarse"], 1e3 * POWER.finger("index").body_height_m, strip_below=0.0).mesh


@pytest.fixture
def gmsh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program gmsh that has one mesh for every STEP file; returns where it is written."""
    mesh = printed_like()
    stored = tmp_path / "stored.msh"
    meshio.Mesh(mesh.nodes, [("tetra", tetrahedra(mesh))]).write(stored, file_format="gmsh22", binary=False)
    program = tmp_path / "bin" / "gmsh"
    program.parent.mkdir()
    program.write_text(
        f"#!{sys.executable}\nimport pathlib, shutil, sys\n"
        "if not pathlib.Path(sys.argv[1]).read_text().startswith('ISO-10303-21'): sys.exit('no STEP file')\n"
        f"shutil.copy({str(stored)!r}, sys.argv[sys.argv.index('-o') + 1])\n"
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(program.parent))
    return stored


@pytest.fixture
def step(tmp_path: Path) -> Path:
    path = tmp_path / "finger_index.step"
    path.write_text("ISO-10303-21;\n")
    return path


def test_four_hexahedra_fill_a_tetrahedron_whichever_way_it_is_numbered():
    rng = np.random.default_rng(1)
    mesh = bar((2.0, 1.0, 1.0), (3, 2, 2))
    cells = tetrahedra(mesh)
    assert (volumes(mesh.nodes, cells) > 0.0).all()
    cells = np.array([cell[rng.permutation(4)] for cell in cells])
    assert (volumes(mesh.nodes, cells) < 0.0).any()
    cut = Mesh(*cut_into_hexahedra(mesh.nodes, cells), np.zeros(4 * len(cells)))  # which refuses inverted ones
    parts = volumes(cut.nodes, cut.hexes[:, KUHN].reshape(-1, 4)).reshape(len(cells), 4 * 6).sum(axis=1)
    assert parts == pytest.approx(np.abs(volumes(mesh.nodes, cells)), rel=1e-12)
    # three quadrilaterals for each outer triangle: two for each of the bar's 2 (3 2 + 3 2 + 2 2) quadrilaterals
    assert len(cut.surface()) == 3 * 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2)


def test_a_solid_closes_as_the_profiles_mesh_of_the_same_shape(gmsh, step):
    solid = mesh_solid(step, FINGER)
    own = mesh_finger(FINGER, RESOLUTIONS["fine"], 1e3 * POWER.finger("index").body_height_m, strip_below=0.0)
    places = (np.array([point.position for point in mesh.routing]) for mesh in (solid, own))
    np.testing.assert_allclose(*places, atol=1e-9)
    for point in solid.routing[1:]:
        assert np.abs(point.weights).sum() < 3.0  # a mean, not a lever
        assert point.weights @ solid.mesh.nodes[point.nodes] == pytest.approx(np.array(point.position), abs=1e-6)
    settings = ClosingSettings(travel_mm=8.0, keyframe_mm=4.0)
    ours, theirs = (
        ClosingPath(POWER, "index", settings, body=Body(POWER, "index", settings.resolution, finger_mesh=mesh)).shape(
            0.008
        )
        for mesh in (solid, own)
    )
    assert ours.converged
    assert theirs.converged
    # 24 hexahedra for one of the coarse mesh; both are stiffer than what they converge to
    assert np.linalg.norm(ours.tip - theirs.tip) < 0.01 * sum(FINGER.link_mm) * 1e-3
    assert ours.tension[0] == pytest.approx(theirs.tension[0], rel=0.05)


def test_slices_are_thin_and_only_neighbours_meet_in_a_hexahedron():
    rng = np.random.default_rng(3)
    mesh = bar((20.0, 2.0, 2.0), (20, 3, 3))
    nodes, hexes = cut_into_hexahedra(mesh.nodes + rng.uniform(-0.2, 0.2, mesh.nodes.shape), tetrahedra(mesh))
    found = slices(nodes[:, 0], hexes, 2.0)
    assert set(found) == set(range(found.max() + 1))
    assert (found[nodes[:, 0] <= 2.0] == 0).all()
    assert (np.diff(found[np.argsort(nodes[:, 0])]) >= 0).all()  # one after the other along the body
    assert (found[hexes].max(axis=1) - found[hexes].min(axis=1)).max() == 1
    # no slice could end sooner: some hexahedron reaches from the slice before its own to its last node
    for number in range(1, found.max()):
        across = (found[hexes].min(axis=1) == number - 1) & (found[hexes].max(axis=1) == number)
        assert nodes[hexes[across], 0].max() == nodes[found == number, 0].max()


def test_a_lip_is_where_its_link_begins_and_a_strip_where_it_is():
    solid = SolidFinger(FINGER, Path("finger_index.step"))
    for joint, apex in enumerate(solid.apex):
        half, slope = 0.5 * FINGER.length_mm[joint], np.tan(0.5 * FINGER.opening_rad[joint])
        lip = 0.9 * half / slope  # so deep the flank has come within a strip's half length
        x = apex + half * np.array([-0.95, 0.95, -0.5, 0.5, -1.2, 1.2])
        y = np.array([-lip, -lip, 1.0, 1.0, 1.0, 1.0])
        found = solid.along(np.column_stack([x, y, np.zeros(6)]))
        assert found == pytest.approx([apex - half, apex + half, *x[2:]])


def test_links_and_the_held_base_lie_between_the_grooves(gmsh, step):
    solid = mesh_solid(step, FINGER)
    x = solid.mesh.nodes[:, 0]
    apex = FINGER.base_mm + np.array([0.0, *np.cumsum(FINGER.link_mm)])
    assert x[solid.clamped].max() == pytest.approx(apex[0] - 0.5 * FINGER.length_mm[0])
    for nodes, (start, end) in zip(solid.link_nodes, itertools.pairwise(apex), strict=True):
        assert len(nodes) > 100
        assert start < x[nodes].min() < x[nodes].max() <= end + 1e-9


def test_the_command_shows_solid_and_own_mesh(gmsh, step, tmp_path, capsys):
    case = ["finger_closing", "--solid", str(step), "--steps", "2", "--out", str(tmp_path)]
    assert simulate.main([*case, "--json", str(tmp_path / "out.json")]) == 0
    states = json.loads((tmp_path / "out.json").read_text())["states"]
    assert [state["pulled_length_m"] for state in states] == pytest.approx([0.010, 0.020])
    for state in states:
        assert state["tip_m"] != state["own_mesh_tip_m"]
        assert np.hypot(*np.subtract(state["tip_m"], state["own_mesh_tip_m"])[:2]) < 2e-3
    assert "profile's mesh" in capsys.readouterr().out


def test_a_solid_of_another_finger_is_refused_with_the_strip_that_differs(gmsh, step, tmp_path, capsys):
    """Links of the three sets are of one length; the mesh is that of the power finger, strip 1 of pinch is 4.27 mm."""
    case = ["finger_closing", "--finger", "pinch/index", "--solid", str(step), "--out", str(tmp_path)]
    assert simulate.main(case) == 2
    assert "thickness of strip 1: expected 4.27 mm, as the profile says, found 3.18 mm" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("case", "finger", "expected"),
    [
        ("tension", "pinch/index", "--finger: expected a case that closes a finger, found"),
        ("finger_closing", "pinch", "--finger: expected PROFILE/FINGER, as power/index, found 'pinch'"),
        ("finger_closing", "pinsh/index", "expected one of hook, pinch, power, found 'pinsh'"),
        ("finger_closing", "pinch/toe", "toe"),
    ],
)
def test_a_finger_that_is_none_is_refused(tmp_path, capsys, case, finger, expected):
    assert simulate.main([case, "--finger", finger, "--out", str(tmp_path)]) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "finger", "expected"),
    [
        (None, "index", "expected a STEP file, as `ros2 run softgrip_design parts` writes it; found none"),
        ("solid", "index", "expected a solid that gmsh can mesh; it says: no STEP file"),
        ("ISO-10303-21;", "thumb", "make the parts of this profile and finger"),
    ],
)
def test_what_is_not_this_fingers_solid_is_refused(gmsh, tmp_path, content, finger, expected):
    path = tmp_path / "some.step"
    if content:
        path.write_text(content)
    with pytest.raises(GdfeError) as refused:
        mesh_solid(path, Finger.from_profile(POWER, finger))
    assert expected in str(refused.value)


def test_without_gmsh_the_error_says_how_to_get_it(step, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(GdfeError, match="apt-get install gmsh"):
        tetrahedra_of(step)
