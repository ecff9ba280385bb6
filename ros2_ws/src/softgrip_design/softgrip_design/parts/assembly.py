# SPDX-License-Identifier: Apache-2.0
"""The hand put together, as a picture: palm, plate on the arm, and its fingers straight in their slots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softgrip_description.hand import Hand
from softgrip_design.parts.palm import finger_pose
from softgrip_design.parts.picture import COLOURS, PictureBody, draw, viewed_from
from softgrip_design.parts.solid import Solid

WIDTH_PX = 900
AZIMUTH_DEG, ELEVATION_DEG = -62.0, 24.0


def assembly_bodies(hand: Hand, solids: Mapping[str, Solid]) -> list[PictureBody]:
    """Return the hand's parts where they belong, in the frame `palm` [mm].

    Args:
        hand: that the parts were made for.
        solids: by name of their form; bench parts among them are left out.
    """
    found = []
    for name, solid in solids.items():
        colour = COLOURS[solid.form.material]
        if name == "palm":
            found.append(PictureBody(solid.vertices, solid.triangles, colour))
        elif name == "palm_plate":
            below = 1e3 * hand.flange_position_m[2]
            found.append(PictureBody(solid.vertices - (0.0, 0.0, below), solid.triangles, colour))
        elif name.startswith("finger_"):
            pose = finger_pose(hand.slots[name.removeprefix("finger_")]).matrix
            found.append(PictureBody(solid.vertices @ pose[:3, :3].T + pose[:3, 3], solid.triangles, colour))
    return found


def assembly_picture(hand: Hand, solids: Mapping[str, Solid]) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3)."""
    return draw(assembly_bodies(hand, solids), viewed_from(AZIMUTH_DEG, ELEVATION_DEG), WIDTH_PX)
