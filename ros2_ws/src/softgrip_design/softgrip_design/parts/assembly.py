# SPDX-License-Identifier: Apache-2.0
"""The hand put together, as a picture: palm, plate, fingers straight in their slots.

Beside it are the servo plate with servos below it and spools on it, and one sheath.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_description.hand import Hand
from softgrip_design.parts import foot
from softgrip_design.parts.drives import FACES, ServoFace
from softgrip_design.parts.forms import PartPose, Point2, Point3
from softgrip_design.parts.palm import WINDOW_MM, finger_pose
from softgrip_design.parts.picture import COLOURS, PictureBody, draw, viewed_from
from softgrip_design.parts.solid import Solid

WIDTH_PX = 1100
AZIMUTH_DEG, ELEVATION_DEG = -30.0, 26.0
#: From the palm's end to the servo plate: less than in the cell, where a sheath of half a metre is between them.
BESIDE_MM = 60.0
#: A servo's case is drawn so deep (that of an X330: 26 mm), a sheath so thick; their colours (blue, green, red).
SERVO_MM, SHEATH_MM = 26.0, 3.0
SERVO_COLOUR, SHEATH_COLOUR = (95, 90, 85), (120, 190, 120)


def assembly_bodies(
    hand: Hand, solids: Mapping[str, Solid], horns_mm: Sequence[Point3] = (), face: ServoFace = FACES[0]
) -> list[PictureBody]:
    """Return the hand's parts where they belong, in the frame `palm` [mm]; the servo plate lies beside the hand.

    Args:
        hand: that the parts were made for.
        solids: by name of their form; bench parts among them are left out.
        horns_mm: where spools stand, in the plate's frame.
        face: of the servos.
    """
    below = -1e3 * hand.flange_position_m[2]
    beside = PartPose((500.0 * hand.palm_size_m[0] + BESIDE_MM, 0.0, below), (0.0, 1.0, 0.0))
    found = []
    for name, solid in solids.items():
        if name == "palm":
            found.append(_body(solid, PartPose(), "palm"))
        elif name == "palm_plate":
            found.append(_body(solid, PartPose((0.0, 0.0, below)), "plate to the arm"))
        elif name.startswith("finger_"):
            slot = name.removeprefix("finger_")
            found.append(_body(solid, finger_pose(hand.slots[slot]), f"finger {slot}"))
        elif name.startswith("servo_plate_"):
            found.append(_body(solid, beside, "servo plate"))
            for number, (x, y, _) in enumerate(horns_mm):
                found.append(_servo(face, beside, (x, y), "" if number else "servos"))
        elif name.startswith("spool_"):
            for number, horn in enumerate(horns_mm):
                x, y, z, _ = beside.matrix @ (*horn, 1.0)
                pose = PartPose((x, y, z), beside.x_axis)
                found.append(_body(solid, pose, "" if number else "spools"))
    plate = next((solid for name, solid in solids.items() if name.startswith("servo_plate_")), None)
    first = next((slot for slot in hand.slots if f"finger_{slot}" in solids), None)
    if plate and first:
        found.append(_sheath(hand, solids[f"finger_{first}"], first, plate, beside))
    return found


def _servo(face: ServoFace, plate: PartPose, at: Point2, name: str) -> PictureBody:
    """Return a servo's case below the plate."""
    (width, height), (x, y) = face.case_mm, at
    high = y + face.axis_mm
    corners = np.array(
        [(x + sx * 0.5 * width, v, z) for sx in (-1.0, 1.0) for v in (high - height, high) for z in (-SERVO_MM, 0.0)]
    )
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    matrix = plate.matrix
    return PictureBody(corners @ matrix[:3, :3].T + matrix[:3, 3], np.array(faces, np.int32), SERVO_COLOUR, name)


def _sheath(hand: Hand, finger: Solid, slot: str, plate: Solid, beside: PartPose) -> PictureBody:
    """Return the sheath of a finger from its foot through the palm's window to the plate's ridge."""
    seats = [bore for bore in finger.form.bores if bore.radius_mm == foot.SHEATH_RADIUS_MM]
    ridges = [bore for bore in plate.form.bores if bore.radius_mm == foot.SHEATH_RADIUS_MM]
    standing = finger_pose(hand.slots[slot]).matrix
    start = (standing @ (*seats[0].start, 1.0))[:3]
    down = -standing[:3, 0]
    ends = [(beside.matrix @ (*bore.end, 1.0))[:3] for bore in ridges]
    end = min(ends, key=lambda one: float(np.linalg.norm(one - start)))
    out = np.array([500.0 * hand.palm_size_m[0] + 4.0, start[1], -1e3 * hand.flange_position_m[2] + WINDOW_MM[1]])
    towards = np.array([-0.5 * BESIDE_MM, 0.0, 0.0])
    points = [start, start + 4.0 * down, out, end + towards, end]
    return _tube(smooth([2.0 * points[0] - points[1], *points, 2.0 * points[-1] - points[-2]]), SHEATH_MM)


def smooth(points: Sequence[NDArray[np.float64]], between: int = 16) -> NDArray[np.float64]:
    """Return a Catmull-Rom curve through all points but the first and the last, (n, 3), so many for each of them."""
    made = []
    for a, b, c, d in zip(points, points[1:], points[2:], points[3:], strict=False):
        for t in np.linspace(0.0, 1.0, between, endpoint=False):
            cubic = (3.0 * (b - c) + d - a) * t**3
            made.append(0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t**2 + cubic))
    return np.array([*made, points[-2]])


def _tube(line: NDArray[np.float64], diameter_mm: float) -> PictureBody:
    """Return a tube of eight sides along a line (n, 3)."""
    sides = 8
    tangents = np.gradient(line, axis=0)
    across = np.cross(tangents, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    above = np.cross(across, tangents)
    above /= np.linalg.norm(above, axis=1, keepdims=True)
    turns = 2.0 * np.pi * np.arange(sides) / sides
    rings = line[:, None] + 0.5 * diameter_mm * (
        np.cos(turns)[:, None] * across[:, None] + np.sin(turns)[:, None] * above[:, None]
    )
    triangles = []
    for ring in range(len(line) - 1):
        for k in range(sides):
            a, b = sides * ring + k, sides * ring + (k + 1) % sides
            triangles += [(a, b, a + sides), (b, b + sides, a + sides)]
    return PictureBody(rings.reshape(-1, 3), np.array(triangles, np.int32), SHEATH_COLOUR, "sheath")


def _body(solid: Solid, pose: PartPose, name: str) -> PictureBody:
    matrix = pose.matrix
    vertices = solid.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return PictureBody(vertices, solid.triangles, COLOURS[solid.form.material], name)


def assembly_picture(
    hand: Hand, solids: Mapping[str, Solid], horns_mm: Sequence[Point3] = (), face: ServoFace = FACES[0]
) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3); see `assembly_bodies`."""
    return draw(assembly_bodies(hand, solids, horns_mm, face), viewed_from(AZIMUTH_DEG, ELEVATION_DEG), WIDTH_PX)
