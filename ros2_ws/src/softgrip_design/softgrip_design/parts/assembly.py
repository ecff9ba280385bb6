# SPDX-License-Identifier: Apache-2.0
"""The hand put together, as a picture: palm, plate, fingers straight in their slots; servo plate beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_description.hand import Hand
from softgrip_design.parts.forms import PartPose, Point3
from softgrip_design.parts.palm import finger_pose
from softgrip_design.parts.picture import COLOURS, PictureBody, draw, viewed_from
from softgrip_design.parts.solid import Solid

WIDTH_PX = 1100
AZIMUTH_DEG, ELEVATION_DEG = -62.0, 24.0
#: From the palm's end to the servo plate: less than in the cell, where a sheath of half a metre is between them.
BESIDE_MM = 60.0


def assembly_bodies(hand: Hand, solids: Mapping[str, Solid], horns_mm: Sequence[Point3] = ()) -> list[PictureBody]:
    """Return the hand's parts where they belong, in the frame `palm` [mm]; the servo plate lies beside the hand.

    Args:
        hand: that the parts were made for.
        solids: by name of their form; bench parts among them are left out.
        horns_mm: where spools stand, in the plate's frame.
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
        elif name.startswith("spool_"):
            for number, horn in enumerate(horns_mm):
                x, y, z, _ = beside.matrix @ (*horn, 1.0)
                pose = PartPose((x, y, z), beside.x_axis)
                found.append(_body(solid, pose, "" if number else "spools"))
    return found


def _body(solid: Solid, pose: PartPose, name: str) -> PictureBody:
    matrix = pose.matrix
    vertices = solid.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return PictureBody(vertices, solid.triangles, COLOURS[solid.form.material], name)


def assembly_picture(hand: Hand, solids: Mapping[str, Solid], horns_mm: Sequence[Point3] = ()) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3); see `assembly_bodies`."""
    return draw(assembly_bodies(hand, solids, horns_mm), viewed_from(AZIMUTH_DEG, ELEVATION_DEG), WIDTH_PX)
