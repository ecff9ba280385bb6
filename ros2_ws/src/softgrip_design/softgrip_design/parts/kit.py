# SPDX-License-Identifier: Apache-2.0
"""All parts of a hand: which there are for a profile and a hand file, and what goes with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_description.hand import Hand
from softgrip_design.parts.bench import WRAP_ANGLES_DEG, camera_stand, grasp_cube, guide_block, target_holder
from softgrip_design.parts.drives import FACES, ServoFace, servo_plate, spool
from softgrip_design.parts.finger_form import FingerForm, finger_form
from softgrip_design.parts.forms import Form, PartError
from softgrip_design.parts.palm import palm_forms, palm_seat
from softgrip_model.profile import Profile


@dataclass(frozen=True)
class OtherDrives:
    """What another servo would take instead.

    Attributes:
        face: of the servo.
        forms: plate and spools; empty where they cannot be made.
        problem: why not.
    """

    face: ServoFace
    forms: tuple[Form, ...] = ()
    problem: str = ""


@dataclass(frozen=True)
class Kit:
    """What to print for a hand.

    Attributes:
        profile: of its fingers.
        hand: that carries them.
        fingers: by slot.
        others: palm, drives, bench; empty where only a finger was asked for.
        instead: drives of the servos that were not chosen.
    """

    profile: Profile
    hand: Hand
    fingers: dict[str, FingerForm]
    others: tuple[Form, ...]
    instead: tuple[OtherDrives, ...] = ()

    @property
    def forms(self) -> tuple[Form, ...]:
        """Every part to print, without those of other servos."""
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


def whole_kit(
    profile: Profile, hand: Hand, spool_radius_mm: float, serial: str = "", face: ServoFace = FACES[0]
) -> Kit:
    """Return everything to print for a hand and its bench.

    Args:
        profile: of the fingers.
        hand: that carries them.
        spool_radius_mm: to the middle of the cable.
        serial: as for `fingers_of`.
        face: of the servos that pull.

    Raises:
        ProfileError, HandError, PartError: see `fingers_of`; or the palm or a spool cannot be made.
    """
    fingers = fingers_of(profile, hand, profile.slots, serial)
    count, cable_mm = len(hand.slots), 1e3 * profile.cable.radius_m
    blocks = [guide_block(angle, "tpu") for angle in WRAP_ANGLES_DEG]
    drives = _drives(face, spool_radius_mm, cable_mm, count)
    others = (*palm_forms(hand), *drives, *blocks, camera_stand(), target_holder(), grasp_cube())
    instead = tuple(_instead(one, spool_radius_mm, cable_mm, count) for one in FACES if one != face)
    return Kit(profile, hand, fingers, others, instead)


def _drives(face: ServoFace, spool_radius_mm: float, cable_mm: float, count: int) -> tuple[Form, Form]:
    return servo_plate(face, spool_radius_mm, count), spool(face, spool_radius_mm, cable_mm, count)


def _instead(face: ServoFace, spool_radius_mm: float, cable_mm: float, count: int) -> OtherDrives:
    try:
        return OtherDrives(face, _drives(face, spool_radius_mm, cable_mm, count))
    except PartError as error:
        return OtherDrives(face, problem=str(error))
