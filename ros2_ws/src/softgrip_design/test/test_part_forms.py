# SPDX-License-Identifier: Apache-2.0
"""Dimensions of parts, without solids: outlines have what the profile says, and what cannot be made is refused."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_description.cell_file import CellFile, ChainServo, ServoChain, save_cell
from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_design.commands import parts
from softgrip_design.parts import bench, drives, foot, forms
from softgrip_design.parts.bill import SHEATH_M, bill_text, bought_rows, cable_m, instead_rows, printed_rows
from softgrip_design.parts.finger_form import FingerForm, finger_form, strip_depth_mm
from softgrip_design.parts.forms import Bore, PartError, circle, corners, polygon, rectangle, segments
from softgrip_design.parts.kit import Kit, fingers_of, whole_kit
from softgrip_design.parts.palm import finger_pose, palm_forms, palm_seat, pin_screw
from softgrip_design.parts.picture import BACKGROUND, INK, NAME_ROOM_PX, PictureBody, draw
from softgrip_design.parts.printing import CLEARANCE_MM, MATERIALS, NOZZLE_MM
from softgrip_design.parts.solid import Solid
from softgrip_model.profile import FingerDesign, ProfileError, load_directory, shipped_directory

HAND = shipped_hand()
SETS = load_directory(shipped_directory())
FINGERS = [(name, slot) for name, profile in SETS.items() for slot in profile.slots]


def made(design: FingerDesign, slot: str = "index", serial: str = "") -> FingerForm:
    return finger_form(design, 0.125, slot, palm_seat(HAND, slot), serial)


def index(**changes: object) -> FingerDesign:
    return dataclasses.replace(SETS["power"].finger("index"), **changes)


def distance_from_line(point: tuple[float, float], line: forms.Segment) -> float:
    (ax, ay), (bx, by) = line.start, line.end
    return abs((bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax)) / math.hypot(bx - ax, by - ay)


def check_dimensions(design: FingerDesign, form: FingerForm) -> None:
    """Measure the outline's own edges and compare them with the profile."""
    edges = [segment for segment in segments(form.form.bodies[0].outline) if segment.middle is None]
    joints = np.concatenate([[0.0], np.cumsum([1e3 * length for length in design.link_lengths_m])])
    for j in range(design.joints):
        half, x = 0.5 * design.openings_rad[j], joints[j]
        length, thickness = 1e3 * design.joint_lengths_m[j], 1e3 * design.thicknesses_m[j]
        lower = [e for e in edges if abs(e.start[1]) < 1e-9 and abs(e.end[1]) < 1e-9 and abs(e.start[0] - x) < length]
        upper = [
            e
            for e in edges
            if max(abs(p[1] - thickness) + abs(abs(p[0] - x) - length / 2) for p in (e.start, e.end)) < 1e-6
        ]
        assert [math.dist(e.start, e.end) for e in (*lower, *upper)] == pytest.approx([length, length], abs=1e-6)
        for side, sign in ((0, -1.0), (1, 1.0)):
            r = 1e3 * design.routing_radii_m[2 * j + side]
            point = (x + sign * r * math.sin(half), -r * math.cos(half))
            flanks = [
                e for e in edges
                if distance_from_line((x, 0.0), e) < 1e-6 and distance_from_line(point, e) < 1e-6
                and min(e.start[1], e.end[1]) < point[1] < max(e.start[1], e.end[1])
            ]  # fmt: skip
            assert len(flanks) == 1, f"joint {j}: the routing point lies on no flank"
            assert any(math.dist(point, end[:2]) < 1e-6 for bore in form.channels for end in (bore.start, bore.end))
    assert max(p[0] for e in edges for p in (e.start, e.end)) == pytest.approx(joints[-1], abs=1e-6)
    assert form.width_mm == pytest.approx(1e3 * design.width_m)


@pytest.mark.parametrize(("name", "slot"), FINGERS)
def test_a_shipped_finger_has_the_dimensions_of_its_profile(name: str, slot: str) -> None:
    design = SETS[name].finger(slot)
    form = made(design, slot, f"{name}-{slot}")
    check_dimensions(design, form)
    assert all(groove.free_rad == pytest.approx(2.0 * groove.half_opening_rad) for groove in form.grooves)
    assert len(form.channels) == design.joints + 1


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(2.5, 5.0), min_size=3, max_size=3),
    st.lists(st.floats(5.0, 13.0), min_size=6, max_size=6),
    st.lists(st.floats(6.0, 12.0), min_size=3, max_size=3),
    st.lists(st.floats(75.0, 90.0), min_size=3, max_size=3),
)
def test_any_finger_that_is_not_refused_has_the_dimensions_of_its_profile(
    h: list[float],
    r: list[float],
    lengths: list[float],
    openings: list[float],
) -> None:
    design = index(
        link_lengths_m=(0.045, 0.035, 0.030),
        thicknesses_m=tuple(1e-3 * value for value in h),
        routing_radii_m=tuple(1e-3 * value for value in r),
        joint_lengths_m=tuple(1e-3 * value for value in lengths),
        openings_rad=tuple(map(math.radians, openings)),
    )
    try:
        form = made(design)
    except PartError:
        return
    check_dimensions(design, form)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"thicknesses_m": (0.0003, 0.003, 0.003)}, "joint 0: expected a strip of at least a nozzle's width"),
        ({"joint_lengths_m": (0.010, 0.025, 0.010)}, "joint 1: expected a strip shorter than the groove's mouth"),
        ({"routing_radii_m": (0.006, 0.0155, 0.006, 0.006, 0.006, 0.006)}, "below routing point 1 expected a wall"),
        ({"routing_radii_m": (0.006, 0.006, 0.0025, 0.006, 0.006, 0.006)}, "joint 1: .* between cable and strip"),
        ({"routing_radii_m": (0.006, 0.006, 0.006, 0.006, 0.0015, 0.006)}, "joint 2: the cable runs through the strip"),
        ({"link_lengths_m": (0.045, 0.0243, 0.023)}, "joint 1: expected 0.8 mm of link"),
        ({"link_lengths_m": (0.045, 0.027, 0.0152)}, "joint 2: expected 0.8 mm of link"),
        ({"width_m": 0.0115}, "as wide as its foot"),
        ({"body_height_m": 0.0135}, "joint 0: expected its groove to end"),
        ({"routing_radii_m": (0.0040, 0.006, 0.006, 0.006, 0.006, 0.006)}, "the foot has room for a cable"),
        ({"routing_radii_m": (0.0145, 0.006, 0.006, 0.006, 0.006, 0.006)}, "the foot has room for a cable"),
    ],
)
def test_a_profile_that_cannot_be_made_is_refused_with_joint_and_reason(changes: dict, reason: str) -> None:
    with pytest.raises(PartError, match=f"finger index, .*{reason}"):
        made(index(**changes))


def test_a_serial_that_does_not_fit_is_refused() -> None:
    with pytest.raises(PartError, match="shorten it"):
        made(index(), serial="a-serial-that-is-much-longer-than-the-link")


@pytest.mark.parametrize("h", [2.5, 5.0])
@pytest.mark.parametrize("angle_deg", [20.0, 60.0, 90.0])
def test_the_depth_of_a_bent_strip_is_where_its_lower_side_crosses_the_flank(h: float, angle_deg: float) -> None:
    length, half, angle = 10.0, math.radians(45.0), math.radians(angle_deg)
    radius = length / angle
    turned = np.linspace(0.0, angle, 200_001)
    x = -0.5 * length + (radius - 0.5 * h) * np.sin(turned)
    y = (radius - 0.5 * h) * (np.cos(turned) - 1.0)
    crossing = np.flatnonzero(np.diff(np.sign(x - y * math.tan(half))))
    assert strip_depth_mm((h, length), half, angle) == pytest.approx(-y[crossing[0]], abs=1e-3)


def test_arcs_are_tangent_and_areas_are_those_of_textbooks() -> None:
    assert forms.area_mm2(circle(5.0)) == pytest.approx(math.pi * 25.0, rel=4e-3)  # chords of 0.01 mm
    assert forms.area_mm2(rectangle((0.0, 10.0), (0.0, 6.0), 2.0)) == pytest.approx(
        60.0 - (4.0 - math.pi) * 4.0, rel=2e-3
    )
    arc = next(s for s in segments(corners((0, 0), (10, 0), (10, 10, 3), (0, 10))) if s.middle)
    assert (arc.start, arc.end) == ((10.0, 7.0), (7.0, 10.0))
    assert math.dist(arc.middle, (7.0, 7.0)) == pytest.approx(3.0)
    with pytest.raises(PartError, match="too short for its roundings"):
        segments(rectangle((0.0, 10.0), (0.0, 3.0), 2.0))


def test_feet_fit_their_own_slot_only() -> None:
    seats = {slot: palm_seat(HAND, slot) for slot in HAND.slots}
    keys = sorted(seat.key_mm for seat in seats.values())
    # the rib of another slot meets full wood: it lies further away than the V's clearance
    assert np.diff(keys).min() > 2.0 * CLEARANCE_MM
    palm, _ = palm_forms(HAND)
    mortises = [cut for cut in palm.pockets if len(cut.outline) == 7]
    for (slot, seat), mortise in zip(seats.items(), mortises, strict=True):
        x, y = polygon(mortise.outline).T
        assert (x.min(), x.max()) == pytest.approx(
            (-foot.HALF_WIDTH_MM - CLEARANCE_MM, foot.HALF_WIDTH_MM + CLEARANCE_MM)
        )
        assert (-y.max(), -y.min()) == pytest.approx((foot.Y_MM[0] - CLEARANCE_MM, foot.Y_MM[1] + CLEARANCE_MM))
        rib = [(c.x_mm, -c.y_mm) for c in mortise.outline if abs(c.x_mm - seat.key_mm) < 1e-9]
        assert rib == [pytest.approx((seat.key_mm, foot.Y_MM[1] + CLEARANCE_MM - foot.KEY_DEPTH_MM))]
        assert finger_pose(HAND.slots[slot]).origin == pytest.approx([1e3 * v for v in HAND.slots[slot].position_m])


def test_a_shoulder_lies_below_the_palm_and_behind_the_first_groove() -> None:
    for name, slot in HAND.slots.items():
        seat = palm_seat(HAND, name)
        height = 1e3 * slot.position_m[2] + seat.shoulder_mm * math.sin(slot.rest_angle_rad)
        assert height <= -foot.DEPTH_MM + 1e-9
        assert seat.shoulder_mm <= -foot.MIN_SHOULDER_MM


def test_a_hand_without_room_for_feet_or_with_flat_fingers_is_refused() -> None:
    low = dataclasses.replace(HAND, flange_position_m=(0.0, 0.0, 0.036))
    with pytest.raises(PartError, match=r"feet reach .* mm below it"):
        palm_forms(low)
    flat = dataclasses.replace(HAND.slots["index"], rest_angle_rad=0.2)
    with pytest.raises(PartError, match="slot index: expected a finger that rises"):
        palm_seat(dataclasses.replace(HAND, slots={"index": flat}), "index")
    with pytest.raises(PartError, match="expected one of index"):
        palm_seat(HAND, "ring")


def test_a_cross_pin_that_meets_another_foot_is_refused() -> None:
    five = load_hand(Path(__file__).parents[4] / "benchmarks/design/five_fingers.yaml")
    assert len(palm_forms(five)[0].pockets) == 2 * 5 + 1
    index, middle = five.slots["index"], five.slots["middle"]
    abreast = dataclasses.replace(middle, position_m=(index.position_m[0], *middle.position_m[1:]))
    with pytest.raises(PartError, match=r"slot middle: .* found the foot of 'index' in its way"):
        palm_forms(dataclasses.replace(five, slots=dict(five.slots) | {"middle": abreast}))


@pytest.mark.parametrize("face", drives.FACES, ids=lambda face: face.name)
def test_holes_lie_on_the_servo_and_a_spool_keeps_its_radius(face: drives.ServoFace) -> None:
    low, high = face.axis_mm - face.case_mm[1], face.axis_mm
    for x, y in face.frame_holes:
        assert abs(x) < 0.5 * face.case_mm[0]
        assert low < y < high
    radius = max(10.0, math.ceil(drives.min_spool_radius_mm(face, 0.125)))
    made_spool = drives.spool(face, radius, 0.125, 3)
    radii = {round(max(c.x_mm for c in body.outline), 6) for body in made_spool.bodies}
    assert radius - 0.125 in radii
    plate = drives.servo_plate(face, radius, 3)
    ways = [bore.start[0] for bore in plate.bores if bore.radius_mm == drives.CABLE_RADIUS_MM]
    axes = [bore.start[0] for bore in plate.bores if bore.radius_mm == face.horn_radius_mm + drives.PLAY_MM]
    # the cable leaves the spool at a tangent, straight into its sheath
    assert [axis - way for axis, way in zip(axes, ways, strict=True)] == pytest.approx([radius] * 3)
    with pytest.raises(PartError, match="screws of the horn need a wall"):
        drives.spool(face, face.horn_holes[1] + 1.0, 0.125, 3)


@pytest.mark.parametrize("face", drives.FACES, ids=lambda face: face.name)
def test_the_screws_of_the_bill_reach_into_horn_and_case_and_no_further(face: drives.ServoFace) -> None:
    found = {text.split(", ")[1].split()[0]: text for text, _ in face.screws}
    lengths = {use: float(text.split(" x ")[1].split()[0].rstrip(",")) for use, text in found.items()}
    into_horn = lengths["spool"] - drives.spool_height_mm(face)
    assert 1.0 < into_horn < (face.horn_thread_mm or face.horn_mm + 0.5)
    assert 1.5 < lengths["plate"] - drives.PLATE_MM < 7.0
    number = {text.split(", ")[1].split()[0]: number for text, number in face.screws}
    assert number == {"plate": len(face.frame_holes), "spool": face.horn_holes[0]}


def test_an_unknown_drive_is_refused() -> None:
    assert drives.face_of("XC430-W240").name == "x430"
    assert drives.face_of("XM540-W150").name == "x540"
    with pytest.raises(PartError, match="expected one of XL330-M288"):
        drives.face_of("SG90")


@pytest.mark.parametrize("angle_deg", bench.WRAP_ANGLES_DEG)
def test_a_guide_block_turns_the_cable_by_its_angle_over_the_surface_of_the_thesis(angle_deg: int) -> None:
    block = bench.guide_block(angle_deg, "tpu")
    (arc,) = [segment for segment in segments(block.bodies[0].outline) if segment.middle]
    chord = 2.0 * 3.0 * math.sin(0.5 * math.radians(angle_deg))
    assert arc.radius_mm == 3.0
    assert math.dist(arc.start, arc.end) == pytest.approx(chord)


def test_the_kit_names_every_part_once_and_the_bill_adds_up() -> None:
    kit = whole_kit(SETS["power"], HAND, 10.0)
    names = [form.name for form in kit.forms]
    assert len(set(names)) == len(names)
    assert {"finger_index", "palm", "servo_plate_x330", "guide_block_90_tpu", "camera_stand", "test_cube"} <= set(names)
    straight = {name: SETS["power"].finger(name).length_m for name in kit.fingers}
    assert cable_m(kit, 10.0) > sum(straight.values()) + 3 * SHEATH_M
    solid = Solid(kit.others[0], None, np.zeros((0, 3)), np.zeros((0, 3), np.int32), 100_000.0)
    (row,) = printed_rows([solid])
    assert row.mass_g == pytest.approx(124.0)  # 100 cm3 of 1.24 g/cm3
    assert row.filament_m == pytest.approx(100.0 / (math.pi * 0.175**2 / 4.0) / 100.0)
    text = bill_text("x", [row], bought_rows(kit, 10.0))
    assert [row for row in text.splitlines() if "cross pin" in row] == [
        "| screw M3 x 30, ISO 4762 | 1 | cross pin of index |",
        "| screw M3 x 30, ISO 4762 | 1 | cross pin of middle |",
        "| screw M3 x 40, ISO 4762 | 1 | cross pin of thumb |",
    ]
    assert "124.0" in text


def test_the_bill_of_five_fingers_has_a_cross_pin_for_each_slot() -> None:
    """Side of the palm + 6.2 mm of foot + 6 mm of thread, the next shorter length: 15, 35 and 45 mm of side."""
    five = load_hand(Path(__file__).parents[4] / "benchmarks/design/five_fingers.yaml")
    form = made(SETS["power"].finger("index"))
    kit = Kit(SETS["power"], five, dict.fromkeys(five.slots, form), ())
    pins = {row.use.split()[-1]: row.title for row in bought_rows(kit, 10.0) if row.use.startswith("cross pin")}
    lengths = {"index": 25, "middle": 45, "ring": 45, "little": 25, "thumb": 50}
    assert pins == {slot: f"screw M3 x {length}, ISO 4762" for slot, length in lengths.items()}


def test_the_bill_has_a_screw_for_every_hole_of_m4_and_a_nut_behind_the_board() -> None:
    """Holes of 4.5 mm are those of M4; the guide blocks are mounted one at a time."""
    kit = whole_kit(SETS["power"], HAND, 10.0)
    holes = {form.name: form.count * sum(bore.radius_mm == 2.25 for bore in form.bores) for form in kit.forms}
    assert {name: number for name, number in holes.items() if number and not name.startswith("guide")} == {
        "palm_plate": 4, "servo_plate_x330": 4, "camera_stand": 4, "target_holder": 8,
    }  # fmt: skip
    assert {number for name, number in holes.items() if name.startswith("guide")} == {2}
    rows = [(row.title, int(row.amount)) for row in bought_rows(kit, 10.0) if row.title.startswith(("screw", "nut"))]
    assert sum(number for title, number in rows if title.startswith("screw M4")) == 4 + 4 + 4 + 8 + 2
    assert ("nut M4, ISO 4032", 4 + 4 + 8 + 2) in rows
    assert ("screw 1/4-20 UNC x 1/2 in", 1) in rows
    lengths = {row.use.split()[0]: float(row.title.split(" x ")[1].split(",")[0])
               for row in bought_rows(kit, 10.0) if row.title.startswith("screw M4")}  # fmt: skip
    for part, thickness in (("servo", 4.0), ("camera", 8.0), ("feet", 18.0), ("guide", 12.0)):
        assert 0.0 <= lengths[part] - thickness - 12.0 - 3.2 < 5.0  # a board of 12 mm and a nut of 3.2 mm
    assert 8.0 <= lengths["plate"] - 5.0 <= 15.0 - 1.0  # two diameters of thread; the post's hole is deeper


@pytest.mark.parametrize(("name", "number"), [("palm_plate", 4), ("spool_x330", 12), ("servo_plate_x330", 12)])
def test_other_holes_for_screws_are_counted_too(name: str, number: int) -> None:
    kit = whole_kit(SETS["power"], HAND, 10.0)
    (form,) = (form for form in kit.forms if form.name == name)
    radius = {"palm_plate": 3.3, "spool_x330": 1.1, "servo_plate_x330": 1.1}[name]
    assert form.count * sum(bore.radius_mm == radius for bore in form.bores) == number
    of_it = {bore.screw.name for bore in form.bores if bore.screw and bore.radius_mm == radius}
    rows = [row for row in bought_rows(kit, 10.0) if row.title.removeprefix("screw ") in of_it]
    assert [int(row.amount) for row in rows] == [number]


def test_a_slot_without_a_screw_for_its_cross_pin_is_refused() -> None:
    def palm(width_mm: float, y_mm: float) -> Hand:
        slot = dataclasses.replace(HAND.slots["index"], position_m=(0.044, 1e-3 * y_mm, 0.0))
        return dataclasses.replace(HAND, palm_size_m=(0.11, 1e-3 * width_mm, 0.03), slots={"index": slot})

    # side + foot 6.2 + thread 6: the next shorter length is sunk by the rest
    assert (pin_screw(palm(60.0, 11.0), "index").length_mm, pin_screw(palm(60.0, 11.0), "index").sunk_mm) == (
        30.0, pytest.approx(1.2),
    )  # fmt: skip
    # 10 mm of side leave no palm below a head that is sunk by 2.2 mm: M3 x 25 ends 8.8 mm in its thread
    assert pin_screw(palm(60.0, 20.0), "index").length_mm == 25.0
    assert pin_screw(palm(60.0, 20.0), "index").sunk_mm == 0.0
    for width_mm, y_mm in ((60.0, 22.0), (110.0, 0.0)):
        with pytest.raises(PartError, match=r"slot index: .* M3 screw of ISO 4762"):
            palm_forms(palm(width_mm, y_mm))


def test_cross_pins_that_meet_are_refused() -> None:
    """Two slots abreast: their threads come from both sides into what is between them."""
    five = load_hand(Path(__file__).parents[4] / "benchmarks/design/five_fingers.yaml")
    ring = dataclasses.replace(five.slots["ring"], position_m=(0.052, -0.010, 0.0))
    with pytest.raises(PartError, match=r"slot middle: .* found that of 'ring'"):
        palm_forms(dataclasses.replace(five, slots=dict(five.slots) | {"ring": ring}))
    near = dataclasses.replace(five.slots["middle"], position_m=(0.052, 0.012, 0.0))
    with pytest.raises(PartError, match=r"slot index: .* found the foot of 'middle'"):
        palm_forms(dataclasses.replace(five, slots=dict(five.slots) | {"middle": near}))


@pytest.mark.parametrize("cable_mm", [0.25, 0.5, 1.0])
def test_a_bead_stays_before_the_hole_that_the_cable_goes_through(cable_mm: float) -> None:
    made = drives.spool(drives.FACES[0], 10.0, 0.5 * cable_mm, 3)
    hole, seat = (bore for bore in made.bores if bore.start[2] > 0.0)
    assert 2.0 * hole.radius_mm >= max(0.8, cable_mm + 0.5)  # two nozzles' widths, or room beside the cable
    assert 2.0 * hole.radius_mm <= 2.0 - 0.4 < 2.0 * seat.radius_mm
    # it begins at the groove's floor
    assert math.hypot(*hole.start[:2]) - hole.radius_mm == pytest.approx(10.0 - 0.5 * cable_mm)


def test_a_cable_too_thick_for_a_bead_is_refused() -> None:
    with pytest.raises(PartError, match=r"spool: expected a cable of at most 1\.1 mm"):
        drives.spool(drives.FACES[0], 10.0, 0.6, 3)


def full(form: forms.Form) -> Solid:
    """A solid of 1 cm3."""
    return Solid(form, None, np.zeros((0, 3)), np.zeros((0, 3), np.int32), 1000.0)


@pytest.mark.parametrize("face", drives.FACES, ids=lambda face: face.name)
def test_the_bill_is_for_the_chosen_servo_and_says_what_others_would_take(face: drives.ServoFace) -> None:
    kit = whole_kit(SETS["power"], HAND, 16.0, face=face)
    mine = {f"servo_plate_{face.name}", f"spool_{face.name}"}
    assert {form.name for form in kit.forms if form.name.startswith(("servo_plate", "spool"))} == mine
    others = {form.name: full(form) for one in kit.instead for form in one.forms}
    assert {one.face for one in kit.instead} == set(drives.FACES) - {face}
    text = bill_text("x", printed_rows([full(form) for form in kit.forms]), bought_rows(kit, 16.0, face, "MY-SERVO"),
                     instead_rows(kit.instead, others))  # fmt: skip
    sums, _, below = text.partition("Other servos instead")
    assert sums.count("| plate for 3 ") == 1
    assert sums.count("| spool of 16 mm ") == 1
    assert "| servo MY-SERVO | 3 |" in sums
    for other in set(drives.FACES) - {face}:
        # a plate and three spools of 1 cm3 in PLA, 1.24 g/cm3
        assert f"| {' or '.join(other.models)} | 5.0 | " in below
        assert f"{3 * other.screws[0][1]} {other.screws[0][0]}" in below


def test_a_spool_that_only_another_servo_forbids_is_made() -> None:
    kit = whole_kit(SETS["power"], HAND, 8.0)
    problems = [row[3] for row in instead_rows(kit.instead, {f.name: full(f) for o in kit.instead for f in o.forms})]
    assert any("expected a radius of at least" in problem for problem in problems)
    with pytest.raises(PartError, match=r"expected a radius of at least 15\.6[23] mm"):  # 13.5 + 1.6 + 0.4 + 0.125
        whole_kit(SETS["power"], HAND, 10.0, face=drives.face_of("DM-J4310-2EC"))


def test_the_servo_is_that_of_the_cell_file(tmp_path: Path) -> None:
    def drive(*models: str, options: tuple[str, ...] = (), radius_m: float | None = 0.012) -> object:
        rows = tuple(ChainServo(f"t{n}", model, n, spool_radius_m=radius_m) for n, model in enumerate(models, start=1))
        save_cell(CellFile("real", servos=ServoChain("/dev/x", 1_000_000, rows)), tmp_path / "cell.yaml")
        chosen = parts._drive(
            parts.parser().parse_args(["power", "--cell-file", str(tmp_path / "cell.yaml"), *options])
        )
        return chosen.model, chosen.face.name, chosen.spool_radius_mm

    assert drive("STS3215", "STS3215") == ("STS3215", "sts3215", 12.0)
    assert drive("XL330-M288", "XC330-M288", radius_m=None) == ("XL330-M288 or XC330-M288", "x330", 10.0)
    assert drive("STS3215", options=("--servo", "XM430-W210", "--spool-radius-mm", "11")) == (
        "XM430-W210",
        "x430",
        11.0,
    )
    with pytest.raises(PartError, match="expected servos with one front, found XL330-M288, STS3215"):
        drive("XL330-M288", "STS3215")
    assert parts._drive(parts.parser().parse_args(["power"])).model == "XL330-M288"


def test_a_servo_that_is_not_known_is_answered_by_those_that_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert parts.main(["power", "--servo", "SG90"]) == 2
    assert "expected one of XL330-M288, " in capsys.readouterr().err


def test_an_xm540s_plate_fits_what_others_have_made_for_it() -> None:
    """RT Corporation's frame for it, drawing RT-SCIURUS17-2-0 (rt-net/sciurus17_Hardware): 8 holes on 22 mm, 10 mm."""
    face = drives.face_of("XM540-W270")
    assert face.horn_holes == (8, 0.5 * 22.0)
    assert face.boss_radius_mm == 0.5 * 10.0


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("powr", "expected one of hook, pinch, power, or a profile file (.yaml), found 'powr'; did you mean 'power'?"),
        ("zzz", "expected one of hook, pinch, power, or a profile file (.yaml), found 'zzz'\n"),
    ],
)
def test_a_misspelt_profile_is_answered_by_the_nearest(
    name: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert parts.main([name]) == 2
    assert text in capsys.readouterr().err


def box(low: tuple[float, float, float], high: tuple[float, float, float], name: str) -> PictureBody:
    corner = np.array(list(itertools.product(*zip(low, high, strict=True))))
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    return PictureBody(corner, np.array(faces, np.int32), (10, 200, 10), name)


def test_a_name_stands_beside_the_picture_with_a_line_to_what_is_seen() -> None:
    """Two boxes side by side, seen from above; a third one lies hidden below the first and gets no line."""
    left, right = box((0.0, 0.0, 0.0), (40.0, 40.0, 10.0), "left"), box((60.0, 0.0, 0.0), (100.0, 40.0, 10.0), "right")
    hidden = box((5.0, 5.0, -20.0), (35.0, 35.0, -10.0), "hidden")
    picture = draw([left, right, hidden], np.eye(3), 700)
    ink = (picture < 100).all(axis=2)
    beside = (ink[:, :NAME_ROOM_PX], ink[:, -NAME_ROOM_PX:])
    assert all(side.any() for side in beside)
    green = (picture[:, :, 1] > 150) & (picture[:, :, 0] < 100)
    assert not green[:, :NAME_ROOM_PX].any()
    for side, columns in ((0, slice(NAME_ROOM_PX, 350)), (1, slice(350, 700 - NAME_ROOM_PX))):
        rows, found = np.nonzero(ink[:, columns])
        boxes = np.nonzero(green[:, columns])
        middle = 0.5 * (boxes[1].min() + boxes[1].max())
        reach = found.max() if side == 0 else found.min()
        assert abs(reach - middle) < 6, "the line ends on the middle of the box"
        assert rows.min() > boxes[0].min()
    unnamed = draw([dataclasses.replace(left, name=""), dataclasses.replace(right, name="")], np.eye(3), 700)
    assert (unnamed[:, 0] == BACKGROUND).all()
    assert not (unnamed == INK).all(axis=2).any()
    only = draw([left, right, dataclasses.replace(hidden, name="")], np.eye(3), 700)
    assert (only == picture).all()


def test_the_cube_is_as_large_as_it_says() -> None:
    cube = bench.grasp_cube()
    (body,) = cube.bodies
    points = np.array([(corner.x_mm, corner.y_mm) for corner in body.outline])
    assert np.ptp(points, axis=0) == pytest.approx([45.0, 45.0])
    assert body.end_mm - body.start_mm == 45.0
    assert (MATERIALS[cube.material].settings["perimeters"], MATERIALS[cube.material].settings["fill_density"]) == (
        "2", "30%",
    )  # fmt: skip


def test_the_cable_of_a_finger_is_as_long_as_its_straight_pieces() -> None:
    form = made(SETS["power"].finger("index"))
    points = [form.channels[0].start, *((*p, 0.0) for g in form.grooves for p in g.routing), form.channels[-1].end]
    assert form.cable_mm == pytest.approx(sum(math.dist(a, b) for a, b in itertools.pairwise(points)))
    assert isinstance(form.channels[0], Bore)


def test_only_fingers_of_the_profile_are_made() -> None:
    with pytest.raises(ProfileError, match="has no finger"):
        fingers_of(SETS["power"], HAND, ["ring"])
    kit = Kit(SETS["power"], HAND, fingers_of(SETS["power"], HAND, ["thumb"], "a7"), ())
    assert [form.name for form in kit.forms] == ["finger_thumb"]
    assert kit.fingers["thumb"].serial == "a7-thumb"


def test_settings_keep_the_layer_and_walls_are_a_nozzle_wide() -> None:
    for material in MATERIALS.values():
        assert float(material.settings["nozzle_diameter"]) == NOZZLE_MM
        assert float(material.settings["filament_density"]) == material.density_g_cm3
