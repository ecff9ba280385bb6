# SPDX-License-Identifier: Apache-2.0
"""Parts as solids: one finger end to end, a palm that it fits, and solids that must be refused."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_design.commands import parts
from softgrip_design.parts import bench, drives, foot
from softgrip_design.parts.assembly import assembly_bodies
from softgrip_design.parts.drawing import write_svg
from softgrip_design.parts.files import write_part
from softgrip_design.parts.forms import Bore, Form, PartError, PartPose, Prism, corners, rectangle
from softgrip_design.parts.kit import fingers_of
from softgrip_design.parts.palm import finger_pose, palm_forms, palm_seat, pin_screw
from softgrip_model.profile import FingerDesign, load, shipped_directory

manifold3d = pytest.importorskip("manifold3d", reason="make parts-setup")
build123d = pytest.importorskip("build123d", reason="make parts-setup")
meshio = pytest.importorskip("meshio")

from softgrip_design.parts.checks import problems_of  # noqa: E402  after the extras
from softgrip_design.parts.solid import Solid, make_solid, triangles_of  # noqa: E402
from softgrip_design.parts.views import FRONT, LEFT, edges_of, views_of  # noqa: E402

HAND = shipped_hand()
FIVE = load_hand(Path(__file__).parents[4] / "benchmarks/design/five_fingers.yaml")
POWER = load(shipped_directory() / "power.yaml")
NOTCH = Prism(rectangle((8.0, 12.0), (4.0, 11.0)), 6.2, 11.0)
BLOCK = Prism(rectangle((0.0, 20.0), (0.0, 10.0)), 0.0, 10.0)


def body_of(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    return manifold3d.Manifold(manifold3d.Mesh64(np.ascontiguousarray(vertices), triangles.astype(np.uint64)))


@pytest.fixture(scope="module")
def index() -> Solid:
    finger = fingers_of(POWER, HAND, ["index"])["index"]
    return make_solid(finger.form, finger.channels)


@pytest.fixture(scope="module")
def palm() -> Any:
    solid = make_solid(palm_forms(HAND)[0])
    return body_of(solid.vertices, solid.triangles)


def placed(solid: Solid, slot: str) -> Any:
    pose = finger_pose(HAND.slots[slot]).matrix
    return body_of(solid.vertices @ pose[:3, :3].T + pose[:3, 3], solid.triangles)


def test_a_finger_fits_its_slot_and_no_other(index: Solid, palm: Any) -> None:
    assert (placed(index, "index") ^ palm).volume() < 1e-3
    assert (placed(index, "middle") ^ palm).volume() > 1.0  # the rib stands in its way
    # it is held, too: lifted out by a millimetre it is free, pushed in by one it meets the shoulder
    along = np.array(finger_pose(HAND.slots["index"]).x_axis)
    assert (placed(index, "index").translate(along) ^ palm).volume() < 1e-3
    assert (placed(index, "index").translate(-along) ^ palm).volume() > 1.0
    across = np.array(finger_pose(HAND.slots["index"]).z_axis)
    assert (placed(index, "index").translate(0.5 * across) ^ palm).volume() > 1.0


def surfaces_along(shape: Any, origin: np.ndarray, axis: np.ndarray, radius_mm: float) -> list[np.ndarray]:
    """Return where lines beside an axis go through a surface: for each of four lines, how far from the origin [mm]."""
    across = np.cross(axis, (0.0, 0.0, 1.0))
    found = []
    for side in (across, -across, np.cross(axis, across), -np.cross(axis, across)):
        start = origin + radius_mm * side
        points = shape.find_intersection_points(build123d.Axis(tuple(start), tuple(axis)))
        found.append(np.unique([round(float((np.array(tuple(point)) - start) @ axis), 4) for point, _ in points]))
    return found


@pytest.mark.parametrize("hand", [HAND, FIVE], ids=lambda hand: hand.name)
def test_a_cross_pin_goes_through_the_foot_into_its_thread_and_ends_before_the_holes_floor(hand: Hand) -> None:
    palm = make_solid(palm_forms(hand)[0]).shape
    for slot in hand.slots:
        length = float(re.fullmatch(r"M3 x ([0-9]+), ISO 4762", pin_screw(hand, slot).name)[1])  # type: ignore[index]
        matrix = finger_pose(hand.slots[slot]).matrix
        origin = (matrix @ (palm_seat(hand, slot).pin_mm, foot.PIN_Y_MM, 0.0, 1.0))[:3]
        inwards = np.array([0.0, -1.0 if origin[1] > 0.0 or (origin[1] == 0.0 and matrix[1, 2] > 0.0) else 1.0, 0.0])
        # beside the shank's hole, below the head: from the head's seat to the slot is palm
        seats, walls = zip(*(one[:2] for one in surfaces_along(palm, origin, inwards, 2.5)), strict=True)
        assert np.ptp(seats) < 1e-3
        assert min(walls) - seats[0] >= 3.0
        tip = seats[0] + length
        # within the clearance hole nothing before the slot's far wall, where the narrower thread's hole begins
        threads = surfaces_along(palm, origin, inwards, 1.45)
        assert all((one > 0.0).all() for one in threads)
        (thread,) = {one[0] for one in threads}
        assert thread == pytest.approx(6.2)  # the foot, 12 mm, with its play
        assert 2.0 * 3.0 <= tip - thread + 1e-6 <= 3.0 * 3.0 + 1e-6
        assert max(one[0] for one in surfaces_along(palm, origin, inwards, 1.2)) >= tip + 0.5
        # the hole ends in the palm, not in the next slot
        floors = [one[0] for one in surfaces_along(palm, origin, inwards, 1.2)]
        assert min(floors) == max(floors)


def test_the_solid_has_strips_of_the_profile(index: Solid) -> None:
    design = POWER.finger("index")
    body = body_of(index.vertices, index.triangles)
    x = 0.0
    for j in range(design.joints):
        h, half = 1e3 * design.thicknesses_m[j], 0.5e3 * design.joint_lengths_m[j]
        # a cut across the strip, away from the marker's pocket: h x width, and nothing of the lips above the slit
        strip = body.trim_by_plane((1.0, 0.0, 0.0), x + 0.8 * half).trim_by_plane((-1.0, 0.0, 0.0), -x - 0.9 * half)
        upper = strip.trim_by_plane((0.0, 1.0, 0.0), -0.1)
        assert upper.volume() == pytest.approx(0.1 * half * h * 1e3 * design.width_m, rel=0.002)
        x += 1e3 * design.link_lengths_m[j]


def check_strips_in_step(text: str, design: FingerDesign) -> None:
    """Look the corners of every strip up among the points of a STEP file."""
    number = r"(-?[0-9.]+(?:E[-+]?[0-9]+)?)"
    rows = re.findall(rf"CARTESIAN_POINT\('[^']*',\({number},{number},{number}\)\)", text)
    points = np.array(rows, dtype=float)
    assert len(points) > 50
    x, width = 0.0, 0.5e3 * design.width_m
    for j in range(design.joints):
        h, half = 1e3 * design.thicknesses_m[j], 0.5e3 * design.joint_lengths_m[j]
        # the back of the last link goes on from its strip without an edge
        for along, y in ((-half, 0.0), (half, 0.0), (-half, h)):
            corner = np.array([x + along, y, -width])
            assert np.linalg.norm(points - corner, axis=1).min() < 1e-6, f"joint {j}: no corner at {corner}"
        x += 1e3 * design.link_lengths_m[j]


def test_one_finger_from_profile_to_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert parts.main(["power", "--finger", "thumb", "--out", str(tmp_path), "--serial", "t1"]) == 0
    assert "finger thumb" in capsys.readouterr().out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"bill.md", *(f"finger_thumb.{ending}" for ending in ("step", "stl", "3mf", "svg"))}
    design = POWER.finger("thumb")
    check_strips_in_step((tmp_path / "finger_thumb.step").read_text(), design)
    stl = meshio.read(tmp_path / "finger_thumb.stl")
    points, numbers = np.unique(stl.points.round(4), axis=0, return_inverse=True)
    body = body_of(points.astype(float), numbers.reshape(-1)[stl.cells_dict["triangle"]])
    assert body.status() == manifold3d.Error.NoError
    grams = re.search(r"NinjaFlex[^|]*\|[^|]*\| ([0-9.]+) \|", (tmp_path / "bill.md").read_text())
    assert grams is not None
    assert float(grams[1]) == pytest.approx(1.19e-3 * body.volume(), abs=0.1)
    # on its side: the width is the height on the bed, layers along the cable
    assert stl.points[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    assert np.ptp(stl.points[:, 2]) == pytest.approx(1e3 * design.width_m, abs=1e-3)
    with zipfile.ZipFile(tmp_path / "finger_thumb.3mf") as archive:
        settings = archive.read("Metadata/Slic3r_PE.config").decode()
        model = archive.read("3D/3dmodel.model").decode()
    assert "; fill_density = 100%" in settings
    assert model.count("<vertex ") == len(points)
    drawing = (tmp_path / "finger_thumb.svg").read_text()
    assert "<svg" in drawing
    for text in ("h0 = 2.550", "l1 = 10.000", "r3 = 7.910", "link 0 = 40.000", "90.00°"):
        assert f">{text}<" in drawing


def test_the_hand_and_the_servo_plate_are_named_in_the_picture() -> None:
    face = drives.FACES[0]
    horns = drives.horn_places_mm(face, 10.0, 3)
    forms = (*palm_forms(HAND), drives.servo_plate(face, 10.0, 3), drives.spool(face, 10.0, 0.125, 3))
    solids = {form.name: make_solid(form) for form in forms}
    bodies = assembly_bodies(HAND, solids, horns)
    names = ["palm", "plate to the arm", "servo plate", "servos", "", "", "spools", "", ""]
    assert [body.name for body in bodies] == names
    palm, _, plate, *others = (body.vertices for body in bodies)
    servos, spools = others[:3], others[3:]
    for servo, spool in zip(servos, spools, strict=True):
        # below the plate, its axis where the spool stands
        assert servo[:, 2].max() == pytest.approx(plate[:, 2].min())
        assert (servo[:, :2].min(axis=0) < spool[:, :2].mean(axis=0)).all()
        assert (servo[:, :2].max(axis=0) > spool[:, :2].mean(axis=0)).all()
    assert plate[:, 0].min() > palm[:, 0].max()
    # each spool stands over a horn's hole of its plate: apart from each other, inside the plate's outline
    middles = [0.5 * (one.min(axis=0) + one.max(axis=0)) for one in spools]
    assert np.diff([middle[1] for middle in middles]) == pytest.approx([horns[1][0] - horns[0][0]] * 2)
    for one in spools:
        assert (one[:, :2].min(axis=0) > plate[:, :2].min(axis=0)).all()
        assert (one[:, :2].max(axis=0) < plate[:, :2].max(axis=0)).all()


def test_a_sheath_goes_from_the_foot_to_the_plates_ridge(index: Solid) -> None:
    plate = make_solid(drives.servo_plate(drives.FACES[0], 10.0, 3))
    *_, drawn_plate, sheath = assembly_bodies(HAND, {index.form.name: index, plate.form.name: plate})
    assert sheath.name == "sheath"
    foot_end = (
        finger_pose(HAND.slots["index"]).matrix @ (palm_seat(HAND, "index").end_mm, -5.38 * 0.5**0.5, 0.0, 1.0)
    )[:3]
    assert np.linalg.norm(sheath.vertices - foot_end, axis=1).min() < 3.0
    assert sheath.vertices[:, 0].max() == pytest.approx(drawn_plate.vertices[:, 0].min(), abs=0.1)


@pytest.mark.parametrize("face", drives.FACES, ids=lambda face: face.name)
def test_plate_and_spool_of_every_servo_are_solids(face: drives.ServoFace) -> None:
    for form in (drives.servo_plate(face, 16.0, 3), drives.spool(face, 16.0, 0.125, 3)):
        solid = make_solid(form)
        assert body_of(solid.vertices, solid.triangles).status() == manifold3d.Error.NoError
    # six holes of the drawing lie where the plate leaves material: between horn and the case's edge
    for x, y in face.frame_holes:
        assert np.hypot(x, y) > face.horn_radius_mm + drives.PLAY_MM + face.frame_radius_mm


def dented_box(apex_mm: float) -> Any:
    """A box of 10 mm whose lid is a pyramid that points down to a height."""
    low, high = ([(x, y, z) for x, y in ((0, 0), (10, 0), (10, 10), (0, 10))] for z in (0, 10))
    apex = (5.0, 5.0, apex_mm)
    sides = [(low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]) for k in range(4)]
    lid = [(high[k], high[(k + 1) % 4], apex) for k in range(4)]
    corners = [tuple(reversed(low)), *sides, *lid]
    wires = [build123d.Wire.make_polygon([build123d.Vector(*one) for one in face], close=True) for face in corners]
    return build123d.Solid(build123d.Shell([build123d.Face(wire) for wire in wires]))


def found_in(shape: Any) -> list[str]:
    return problems_of(shape, *triangles_of(shape), (), ())


def test_a_surface_that_cuts_itself_is_found() -> None:
    whole, cut = dented_box(5.0), dented_box(-5.0)
    # a cube less its pyramid; a deeper dent comes out below the floor, and neither BRepCheck nor manifold3d mind
    assert whole.volume == pytest.approx(1000.0 - 500.0 / 3.0)
    assert whole.is_valid
    assert cut.is_valid
    assert found_in(whole) == []
    assert "its surface cuts itself (Open CASCADE's BOPAlgo_ArgumentAnalyzer)" in found_in(cut)


def test_a_drawing_shows_a_part_as_it_is(tmp_path: Path) -> None:
    # a step: 20 x 10 below, 8 x 10 above it on the left, a blind hole from above in the lower half
    step = Prism(rectangle((0.0, 8.0), (0.0, 10.0)), 9.0, 16.0)
    holes = (Bore((14.0, 4.0, 10.0), (14.0, 4.0, 3.0), 2.0, beyond_mm=(1.0, 0.0)),)
    solid = make_solid(Form("step", "step", "pla", (BLOCK, step), holes, count=2))
    write_svg(views_of(solid), tmp_path / "step.svg")
    drawing = (tmp_path / "step.svg").read_text()
    texts = re.findall(r">([^<>]+)</text>", drawing)
    assert [texts.count(size) for size in ("20.00", "16.00", "10.00")] == [2, 2, 2]
    assert "A: 1 x Ø4.00, along z, 7.00 long, from (14.00, 4.00, 10.00)" in texts
    assert texts.count("A") == 1
    seen, hidden = edges_of(solid, FRONT)
    # from the front: the outline of an L, no edge in it; the hole is hidden behind it
    corners_of_l = [(0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (8.0, 10.0), (8.0, 16.0), (0.0, 16.0), (0.0, 0.0)]
    assert spans(seen) == {tuple(sorted(edge)) for edge in itertools.pairwise(corners_of_l)}
    assert ((12.0, 3.0), (12.0, 10.0)) in spans(hidden)
    # from the left it is the wall of 10 x 16, the step's back is hidden, and y runs to the left
    seen, hidden = edges_of(solid, LEFT)
    assert {span for span in spans(seen) if span[0] == (-10.0, 0.0)} >= {((-10.0, 0.0), (0.0, 0.0))}
    assert ((-10.0, 10.0), (0.0, 10.0)) in spans(hidden)


def spans(edges: list[np.ndarray]) -> set[tuple[tuple[float, float], tuple[float, float]]]:
    """Return straight lines as (lower left, upper right), joined where they follow each other, without points."""
    lines = [edge.round(3) + 0.0 for edge in edges if len(edge) == 2 and np.ptp(edge, axis=0).max() > 1e-3]
    joined = True
    while joined:
        joined = False
        for a, b in itertools.combinations(range(len(lines)), 2):
            both = np.vstack([lines[a], lines[b]])
            axis = int(np.ptp(both, axis=0).argmax())
            flat = np.ptp(both[:, 1 - axis]) < 1e-3
            if flat and np.ptp(both[:, axis]) <= np.ptp(lines[a][:, axis]) + np.ptp(lines[b][:, axis]) + 1e-3:
                lines = [line for k, line in enumerate(lines) if k not in {a, b}]
                lines.append(np.array([both.min(axis=0), both.max(axis=0)]))
                joined = True
                break
    return {(tuple(line.min(axis=0)), tuple(line.max(axis=0))) for line in lines}


@pytest.mark.skipif(shutil.which("prusa-slicer") is None, reason="no PrusaSlicer here (apt-get install prusa-slicer)")
def test_the_cube_weighs_what_its_product_does(tmp_path: Path) -> None:
    write_part(make_solid(bench.grasp_cube()), tmp_path)
    gcode = tmp_path / "cube.gcode"
    command = ["prusa-slicer", "--export-gcode", "--output", str(gcode), str(tmp_path / "test_cube.3mf")]
    subprocess.run(command, capture_output=True, check=True, timeout=120)
    grams = re.search(r"^; total filament used \[g\] = ([0-9.]+)", gcode.read_text(), re.MULTILINE)
    assert grams is not None
    assert float(grams[1]) == pytest.approx(bench.CUBE_G, rel=0.1)


def test_a_profile_that_cannot_be_made_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (shipped_directory() / "power.yaml").read_text().replace("0.00538, 0.00574", "0.00250, 0.00574")
    (tmp_path / "bad.yaml").write_text(text)
    assert parts.main([str(tmp_path / "bad.yaml"), "--finger", "index", "--out", str(tmp_path / "out")]) == 2
    assert "finger index, joint 0" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("bores", "pockets", "reason"),
    [
        ((Bore((0.0, 5.0, 1.3), (20.0, 5.0, 1.3), 1.0),), (), "its wall of 0.4 mm lacks"),
        ((Bore((0.0, 5.0, 5.0), (20.0, 5.0, 5.0), 1.0),), (NOTCH,), "its wall of 0.4 mm lacks"),
        ((Bore((0.0, 5.0, 5.0), (9.0, 5.0, 5.0), 1.0),), (), "is not open"),
    ],
)  # fmt: skip
def test_a_channel_that_is_cut_or_closed_is_refused(
    bores: tuple[Bore, ...], pockets: tuple[Prism, ...], reason: str
) -> None:
    channel = Bore((0.0, *bores[0].start[1:]), (20.0, *bores[0].start[1:]), 1.0)
    with pytest.raises(PartError, match=reason):
        make_solid(Form("block", "block", "pla", (BLOCK,), bores, pockets), (channel,))


def fin(width_mm: float) -> Prism:
    return Prism(rectangle((2.0, 2.0 + width_mm), (0.0, 10.0)), 9.0, 15.0)


def test_a_wall_thinner_than_the_nozzle_is_refused_wherever_it_stands() -> None:
    make_solid(Form("b", "b", "pla", (BLOCK, fin(0.5))))
    with pytest.raises(PartError, match=r"found 0.30 mm at \(2\.[03], \d\.\d, 1[0-5]\.\d\)"):
        make_solid(Form("b", "b", "pla", (BLOCK, fin(0.3))))
    # a floor: what a pocket leaves of the block
    pocket = Prism(rectangle((5.0, 15.0), (2.0, 8.0)), 0.25, 11.0)
    with pytest.raises(PartError, match=r"found 0.25 mm at"):
        make_solid(Form("b", "b", "pla", (BLOCK,), (), (pocket,)))
    # the edge of a wedge of 30 deg is thin, and no wall
    slope = PartPose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    make_solid(Form("w", "w", "pla", (Prism(corners((0.0, 0.0), (20.0, 0.0), (20.0, 11.5)), 0.0, 10.0, slope),)))


def test_between_the_strokes_of_letters_is_no_wall_and_below_them_is_one() -> None:
    strokes = tuple(Prism(rectangle((x, x + 1.0), (2.0, 8.0)), 9.6, 11.0) for x in (5.0, 6.2))  # a rib of 0.2 mm
    make_solid(Form("b", "b", "pla", (BLOCK,), letters=strokes))
    with pytest.raises(PartError, match=r"found 0.20 mm at \(6\."):
        make_solid(Form("b", "b", "pla", (BLOCK,), (), strokes))
    deep = tuple(Prism(stroke.outline, 0.3, 11.0) for stroke in strokes)
    with pytest.raises(PartError, match=r"found 0.30 mm at"):
        make_solid(Form("b", "b", "pla", (BLOCK,), letters=deep))


def test_a_marker_seat_near_the_back_is_open_there(index: Solid) -> None:
    # strips of 2.55 mm behind dots of 2.6 mm radius would leave a sliver: the uppermost layer has none
    width, h = 1e3 * POWER.finger("index").width_m, 1e3 * POWER.finger("index").thicknesses_m[0]
    top = body_of(index.vertices, index.triangles).trim_by_plane((0.0, 0.0, 1.0), 0.5 * width - 0.1)
    assert h == pytest.approx(2.55)
    for x in (0.0, 0.7):
        column = top.trim_by_plane((1.0, 0.0, 0.0), x - 0.05).trim_by_plane((-1.0, 0.0, 0.0), -x - 0.05)
        assert column.trim_by_plane((0.0, 1.0, 0.0), 0.0).is_empty()


def test_a_part_in_two_pieces_is_refused() -> None:
    with pytest.raises(PartError, match="expected one piece, found 2"):
        make_solid(Form("b", "b", "pla", (BLOCK,), (), (Prism(rectangle((9.0, 11.0), (-1.0, 11.0)), -1.0, 11.0),)))


def test_a_mouth_that_is_cut_by_a_surface_is_refused() -> None:
    bore = Bore((0.0, 9.8, 5.0), (20.0, 9.8, 5.0), 0.6, (0.5, 0.0), (1.0, 1.0))
    with pytest.raises(PartError, match="has no whole mouth"):
        make_solid(Form("b", "b", "pla", (BLOCK,), (bore,)))
