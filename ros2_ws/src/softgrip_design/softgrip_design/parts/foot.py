# SPDX-License-Identifier: Apache-2.0
"""What finger and palm agree on: a finger's tenon, and how deep it sits in its slot (mortise and tenon, section 4.2.2).

Lengths in mm, in the finger's frame: x along the straight finger from its first joint, closing towards -y, z across.
The thesis draws no foot; its dimensions are chosen here, once for all finger sets, so that any set fits the same palm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_description.hand import HandSlot

#: Section of the tenon: y and z. Deep enough for cables within the bounds of section 4.2.3 and openings from 80 deg:
#: r0 = 13 mm lies 13 cos 40 deg = 9.96 mm deep.
Y_MM, HALF_WIDTH_MM = (-12.0, 4.0), 6.0
LENGTH_MM = 16.0
#: The body behind the first groove: its back covers the tenon by this much, and its front is at least this deep.
SHOULDER_MM, BODY_DEPTH_MM = 2.0, 12.0
#: The shoulder lies this far behind the first joint at least, so that the first groove's flank is in front of it.
MIN_SHOULDER_MM = 14.0
#: ... and this deep below the palm's surface, so that the tenon is held.
DEPTH_MM = 10.0
#: A V on the back of the tenon; each slot has it at another place across.
KEY_DEPTH_MM, KEY_REACH_MM = 1.5, 3.5
#: Cross pin (an M3 screw) through the tenon's middle, clear of the cable below it.
PIN_Y_MM, PIN_RADIUS_MM, PIN_TAP_RADIUS_MM = 0.6, 1.6, 1.25
#: Seat of the cable's sheath (PTFE tube 2 x 3 mm) in the end of the tenon.
SHEATH_RADIUS_MM, SHEATH_DEPTH_MM = 1.55, 5.0


@dataclass(frozen=True)
class Seat:
    """How one finger sits in its slot.

    Attributes:
        shoulder_mm: x of the shoulder, negative.
        key_mm: place of the key across.
    """

    shoulder_mm: float
    key_mm: float

    @property
    def end_mm(self) -> float:
        """X of the tenon's end."""
        return self.shoulder_mm - LENGTH_MM

    @property
    def pin_mm(self) -> float:
        """X of the cross pin."""
        return self.shoulder_mm - 0.5 * LENGTH_MM


def seat(slots: Sequence[str], name: str, slot: HandSlot) -> Seat:
    """Return how the finger of a slot sits.

    Args:
        slots: names of the hand's slots in its own order; it decides the places of the keys.
        name: of the slot.
        slot: of the hand file.
    """
    joint_height_mm = 1e3 * slot.position_m[2]
    sunk = (joint_height_mm + DEPTH_MM) / math.sin(slot.rest_angle_rad)
    share = 0.5 if len(slots) == 1 else list(slots).index(name) / (len(slots) - 1)
    return Seat(-max(MIN_SHOULDER_MM, sunk), KEY_REACH_MM * (2.0 * share - 1.0))
