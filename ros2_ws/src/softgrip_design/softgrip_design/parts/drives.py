# SPDX-License-Identifier: Apache-2.0
"""Servo plate and spools for the servos that tendon_driver supports. Lengths in mm.

The plate is screwed to the fronts of the servos; their horns reach through it to the spools. A wall beside it holds the
sheaths of the cables where they meet the spools.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from softgrip_design.parts import foot
from softgrip_design.parts.forms import Bore, Form, PartError, Point2, Point3, Prism, Screw, circle, rectangle
from softgrip_design.parts.printing import NOZZLE_MM
from softgrip_design.parts.screws import board_screw


@dataclass(frozen=True)
class ServoFace:
    """The front of a servo, seen from its horn, axis at (0, 0), y towards the nearer end of the case.

    Attributes:
        name: of the family, in file names.
        models: with this front, as tendon_driver names them.
        case_mm: width and height of the case.
        axis_mm: from the axis to the case's nearer end.
        horn_radius_mm, horn_mm: of the horn, and how far it stands out of the case.
        boss_radius_mm: of what stands out of the horn's middle.
        horn_holes: number, and radius of their circle.
        frame_holes: in the case, for the plate.
        frame_radius_mm, horn_hole_radius_mm: clearance of the screws.
        screws: for the plate and for the horn, how many a servo, as it is ordered.
        source: drawing.
        horn_thread_mm: depth of the threads behind the horn's face; 0: as deep as the horn is thick.
    """

    name: str
    models: tuple[str, ...]
    case_mm: tuple[float, float]
    axis_mm: float
    horn_radius_mm: float
    horn_mm: float
    boss_radius_mm: float
    horn_holes: tuple[int, float]
    frame_holes: tuple[Point2, ...]
    frame_radius_mm: float
    horn_hole_radius_mm: float
    screws: tuple[tuple[str, int], ...]
    source: str
    horn_thread_mm: float = 0.0

    def screw(self, number: int) -> Screw:
        """Return the screw of the plate (0) or of the horn (1)."""
        return Screw(self.screws[number][0], "servos")


#: From the maker's drawings, which the e-manual links, as several who measured by them publish the numbers.
FACES = (
    ServoFace(
        name="x330",
        models=("XL330-M288", "XC330-M288", "XC330-T288"),
        case_mm=(20.0, 34.0),
        axis_mm=9.5,
        horn_radius_mm=8.0,
        horn_mm=3.0,
        boss_radius_mm=3.0,
        horn_holes=(4, 6.0),
        frame_holes=((-8.0, 7.5), (8.0, 7.5), (-8.0, -22.5), (8.0, -22.5)),
        frame_radius_mm=1.1,
        horn_hole_radius_mm=1.1,
        screws=(("M2 x 10 self-tapping, plate", 4), ("M2 x 12 self-tapping, spool", 4)),
        source="ROBOTIS drawing X330, 28 May 2020 (XL,XC-330.pdf, e-manual XL330-M288-T, Drawings)",
    ),
    ServoFace(
        name="x430",
        models=("XM430-W350", "XM430-W210", "XL430-W250", "XC430-W150", "XC430-W240"),
        case_mm=(28.5, 46.5),
        axis_mm=11.25,
        horn_radius_mm=9.75,
        horn_mm=2.0,
        boss_radius_mm=4.0,
        horn_holes=(8, 8.0),
        frame_holes=((-11.0, -8.0), (11.0, -8.0)),
        frame_radius_mm=1.35,
        horn_hole_radius_mm=1.1,
        screws=(("M2.5 x 6, plate (self-tapping in the plastic cases of XL430, XC430)", 2), ("M2 x 12, spool", 8)),
        source="ROBOTIS drawings XM430/XH430 (HINGE), 19 Mar 2019, and HN12-N101 (e-manual XM430-W350, Drawings); "
        "XL430 and XC430: e-manual XM430-W350, 'same form factors'",
    ),
    ServoFace(
        name="x540",
        models=("XM540-W270", "XM540-W150"),
        case_mm=(33.5, 58.5),
        axis_mm=13.75,
        horn_radius_mm=13.0,
        horn_mm=2.6,
        boss_radius_mm=5.0,
        horn_holes=(8, 11.0),
        frame_holes=((-13.5, -10.5), (13.5, -10.5)),
        frame_radius_mm=1.35,
        horn_hole_radius_mm=1.35,
        screws=(("M2.5 x 6, plate", 2), ("M2.5 x 12, spool", 8)),
        source="ROBOTIS drawings XM540/XH540/XD540 (HINGE), 18 Mar 2019, and HN13-N101, 22 May 2019 (e-manual "
        "XM540-W270, Drawings); its horn wants a spool of 13 mm or more, tendon_driver one of 25 mm (docs/driver.md)",
        horn_thread_mm=2.5,
    ),
    ServoFace(
        name="sts3215",
        models=("STS3215",),
        case_mm=(24.82, 45.42),
        axis_mm=10.21,
        horn_radius_mm=10.0,
        horn_mm=2.8,
        boss_radius_mm=2.7,
        horn_holes=(4, 7.0),
        frame_holes=((-10.25, -8.3), (10.25, -8.3), (-10.25, -29.0), (10.25, -29.0)),
        frame_radius_mm=1.1,
        horn_hole_radius_mm=1.6,
        screws=(("M2 x 8 self-tapping, plate", 4), ("M3 x 12, spool", 4)),
        source="measured in TheRobotStudio/SO-ARM100, STEP/SO100/STS3215_03a.step (no drawing of the maker was found)",
    ),
    ServoFace(
        name="dm4310",
        models=("DM-J4310-2EC",),
        case_mm=(57.0, 57.0),
        axis_mm=28.5,
        horn_radius_mm=17.5,
        horn_mm=1.0,
        boss_radius_mm=0.0,
        horn_holes=(6, 13.5),
        frame_holes=tuple(
            (25.0 * math.cos(math.radians(angle)), 25.0 * math.sin(math.radians(angle))) for angle in range(30, 360, 60)
        ),
        frame_radius_mm=1.6,
        horn_hole_radius_mm=1.6,
        screws=(("M3 x 8, plate", 6), ("M3 x 16, spool", 6)),
        source="Damiao drawing DM_J4310_V1.1, Ver.B20230904 (github.com/dmBots/DM-J4310-2EC, 2D drawings); its "
        "output flange wants a spool of 15.7 mm or more",
        horn_thread_mm=5.0,
    ),
)

PLATE_MM, RAIL_MM, EDGE_MM = 4.0, 8.0, 1.0
#: Room around a horn and its spool, and between neighbours.
PLAY_MM = 0.5
NEIGHBOUR_MM = 3.0
#: Holes for M4 screws to the bench.
M4_MM, RIM_MM = 2.25, 8.0
#: Spool: width of the groove, thickness and height of its rims, floor above the horn that the screws hold.
GROOVE_MM, FLANGE_MM, RIM_HEIGHT_MM = 5.0, 1.6, 2.5
#: Knot hole: room beside the cable, at least two nozzles wide; recess for the bead of 2 mm before the knot.
KNOT_PLAY_MM, BEAD_MM, BEAD_SEAT_MM = 0.25, 2.0, 1.6
#: Channel of the cable through the wall.
CABLE_RADIUS_MM = 0.8


def face_of(model: str) -> ServoFace:
    """Return the front of a servo model.

    Raises:
        PartError: no such model.
    """
    for face in FACES:
        if model in face.models:
            return face
    known = ", ".join(model for face in FACES for model in face.models)
    raise PartError(f"servo: expected one of {known}, found {model!r}")


def spool_height_mm(face: ServoFace) -> float:
    """Return how high a spool stands on its horn: so much of its screws is not in the horn."""
    return _lift_mm(face) + 2.0 * FLANGE_MM + GROOVE_MM


def _lift_mm(face: ServoFace) -> float:
    """Return how far a spool's neck reaches from its rim down to the horn."""
    return PLATE_MM - face.horn_mm + PLAY_MM


def _pitch_mm(face: ServoFace, spool_radius_mm: float) -> float:
    """Return the distance between the axes of neighbours."""
    return max(face.case_mm[0], 2.0 * (spool_radius_mm + RIM_HEIGHT_MM)) + NEIGHBOUR_MM


def horn_places_mm(face: ServoFace, spool_radius_mm: float, count: int) -> list[Point3]:
    """Return where the spools stand on the horns, in the plate's frame."""
    pitch = _pitch_mm(face, spool_radius_mm)
    return [(pitch * (k - 0.5 * (count - 1)), 0.0, face.horn_mm) for k in range(count)]


def servo_plate(face: ServoFace, spool_radius_mm: float, count: int) -> Form:
    """Return the plate for a number of servos side by side.

    Args:
        face: of the servos.
        spool_radius_mm: to the middle of the cable.
        count: of servos.
    """
    rim = spool_radius_mm + RIM_HEIGHT_MM
    axes = [x for x, _, _ in horn_places_mm(face, spool_radius_mm, count)]
    pitch = _pitch_mm(face, spool_radius_mm)
    top = max(face.axis_mm, rim) + PLAY_MM
    low, high = face.axis_mm - face.case_mm[1] - 2.0 * RIM_MM, top + RAIL_MM
    half = 0.5 * pitch * count + 2.0 * RIM_MM
    cable_z = PLATE_MM + PLAY_MM + FLANGE_MM + 0.5 * GROOVE_MM
    height = cable_z + foot.SHEATH_RADIUS_MM + 4.0 * NOZZLE_MM
    plate = Prism(rectangle((-half, half), (low, high), 3.0), 0.0, PLATE_MM)
    wall = Prism(rectangle((-half, half), (top, high)), 0.0, height)
    bores = []
    for x in axes:
        bores.append(_hole((x, 0.0), face.horn_radius_mm + PLAY_MM))
        bores += [_hole((x + u, v), face.frame_radius_mm, face.screw(0)) for u, v in face.frame_holes]
        at = x - spool_radius_mm
        bores.append(Bore((at, top, cable_z), (at, high, cable_z), CABLE_RADIUS_MM, beyond_mm=(EDGE_MM, EDGE_MM)))
        seat = (at, high - foot.SHEATH_DEPTH_MM, cable_z)
        bores.append(Bore(seat, (at, high, cable_z), foot.SHEATH_RADIUS_MM, beyond_mm=(0.0, EDGE_MM)))
    to_board = board_screw(PLATE_MM, "servo plate to the board")
    bores += [_hole((sx * (half - RIM_MM), y), M4_MM, to_board) for sx in (-1, 1) for y in (low + RIM_MM, top - RIM_MM)]
    return Form(f"servo_plate_{face.name}", f"plate for {count} {' or '.join(face.models)}", "pla", (plate, wall),
                tuple(bores))  # fmt: skip


def _hole(at: Point2, radius_mm: float, screw: Screw | None = None) -> Bore:
    return Bore((*at, 0.0), (*at, PLATE_MM), radius_mm, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw)


def knot_radius_mm(cable_radius_mm: float) -> float:
    """Return the radius of a spool's knot hole.

    Raises:
        PartError: a bead would not stay before it.
    """
    radius = max(NOZZLE_MM, cable_radius_mm + KNOT_PLAY_MM)
    if 2.0 * radius > BEAD_MM - NOZZLE_MM:
        raise PartError(
            f"spool: expected a cable of at most {BEAD_MM - NOZZLE_MM - 2.0 * KNOT_PLAY_MM:g} mm, before whose hole a "
            f"bead of {BEAD_MM:g} mm stays, found {2.0 * cable_radius_mm:g} mm"
        )
    return radius


def min_spool_radius_mm(face: ServoFace, cable_radius_mm: float) -> float:
    """Return the smallest radius, to the middle of the cable, that leaves a wall outside the horn's screws."""
    _, circle_mm = face.horn_holes
    return circle_mm + face.horn_hole_radius_mm + NOZZLE_MM + cable_radius_mm


def spool(face: ServoFace, spool_radius_mm: float, cable_radius_mm: float, count: int) -> Form:
    """Return a spool: its neck stands on the horn, the cable's bead sits in the upper rim.

    Raises:
        PartError: the radius leaves no wall outside the horn's screws, or the cable is too thick.
    """
    floor = spool_radius_mm - cable_radius_mm
    holes, circle_mm = face.horn_holes
    needed = min_spool_radius_mm(face, cable_radius_mm)
    if spool_radius_mm < needed:
        raise PartError(
            f"spool for {face.models[0]}: expected a radius of at least {needed:.2f} mm, found {spool_radius_mm:g} mm: "
            "the screws of the horn need a wall around them"
        )
    rim = spool_radius_mm + RIM_HEIGHT_MM
    lift = _lift_mm(face)
    levels = [0.0, lift, lift + FLANGE_MM, lift + FLANGE_MM + GROOVE_MM, lift + 2.0 * FLANGE_MM + GROOVE_MM]
    neck = min(face.horn_radius_mm, floor)
    bodies = (
        Prism(circle(neck), levels[0], levels[4]),
        Prism(circle(rim), levels[1], levels[2]),
        Prism(circle(floor), levels[1], levels[4]),
        Prism(circle(rim), levels[3], levels[4]),
    )
    through = [(circle_mm * math.cos(a), circle_mm * math.sin(a)) for a in _turns(holes)]
    bores = [_through((0.0, 0.0), face.boss_radius_mm + PLAY_MM, levels[4])]
    bores += [_through(at, face.horn_hole_radius_mm, levels[4], face.screw(1)) for at in through]
    # between two screws: from the groove up through the rim, behind which the bead sits
    turn, radius = math.pi / holes, knot_radius_mm(cable_radius_mm)
    at = ((floor + radius) * math.cos(turn), (floor + radius) * math.sin(turn))
    seat = (*at, levels[4] - 0.5 * FLANGE_MM)
    bores.append(Bore((*at, levels[3] - EDGE_MM), (*at, levels[4]), radius, beyond_mm=(0.0, EDGE_MM)))
    bores.append(Bore(seat, (*at, levels[4]), BEAD_SEAT_MM, beyond_mm=(0.0, EDGE_MM)))
    return Form(f"spool_{face.name}", f"spool of {spool_radius_mm:g} mm for {face.models[0]}", "pla", bodies,
                tuple(bores), up=(0.0, 0.0, -1.0), count=count)  # fmt: skip


def _turns(count: int) -> list[float]:
    return [2.0 * math.pi * k / count for k in range(count)]


def _through(at: Point2, radius_mm: float, top_mm: float, screw: Screw | None = None) -> Bore:
    return Bore((*at, 0.0), (*at, top_mm), radius_mm, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw)
