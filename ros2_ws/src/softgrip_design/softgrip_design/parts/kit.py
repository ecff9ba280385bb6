# SPDX-License-Identifier: Apache-2.0
"""All parts of a hand: which there are for a profile and a hand file, and what goes with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_description.hand import Hand
from softgrip_design.parts.bench import WRAP_ANGLES_DEG, camera_stand, guide_block, target_holder
from softgrip_design.parts.drives import FACES, servo_plate, spool
from softgrip_design.parts.finger_form import FingerForm, finger_form
from softgrip_design.parts.forms import Form
from softgrip_design.parts.palm import palm_forms, palm_seat
from softgrip_model.profile import Profile


@dataclass(frozen=True)
class Kit:
    """What to print for a hand.

    Attributes:
        profile: of its fingers.
        hand: that carries them.
        fingers: by slot.
        others: palm, drives, bench; empty where only a finger was asked for.
    """

    profile: Profile
    hand: Hand
    fingers: dict[str, FingerForm]
    others: tuple[Form, ...]

    @property
    def forms(self) -> tuple[Form, ...]:
        """Every part."""
        return (*(finger.form for finger in self.fingers.values()), *self.others)


def fingers_of(profile: Profile, hand: Hand, slots: Sequence[str], serial: str = "") -> dict[str, FingerForm]:
    """Return fingers by slot.

    Args:
        profile: of the fingers.
        hand: that carries them.
        slots: whose fingers.
        serial: engraved before the slot's name; empty: the profile's id.

    Raises:
        ProfileError: the profile has no finger for a slot.
        HandError: a finger does not fit its slot.
        PartError: a finger cannot be made.
    """
    designs = {name: profile.finger(name) for name in slots}
    hand.check_mounting(designs)
    return {
        name: finger_form(
            design, 1e3 * profile.cable.radius_m, name, palm_seat(hand, name), f"{serial or profile.id}-{name}"
        )
        for name, design in designs.items()
    }


def whole_kit(profile: Profile, hand: Hand, spool_radius_mm: float, serial: str = "") -> Kit:
    """Return everything to print for a hand and its bench.

    Raises:
        ProfileError, HandError, PartError: see `fingers_of`; or the palm or a spool cannot be made.
    """
    fingers = fingers_of(profile, hand, profile.slots, serial)
    count, cable_mm = len(hand.slots), 1e3 * profile.cable.radius_m
    drives = [servo_plate(face, spool_radius_mm, count) for face in FACES]
    spools = [spool(face, spool_radius_mm, cable_mm, count) for face in FACES]
    blocks = [guide_block(angle, "tpu") for angle in WRAP_ANGLES_DEG]
    others = (*palm_forms(hand), *drives, *spools, *blocks, camera_stand(), target_holder())
    return Kit(profile, hand, fingers, others)
