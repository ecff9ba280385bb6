# SPDX-License-Identifier: Apache-2.0
"""The fingers that are designed: lengths of Fig 4.1, material of section 4.2.2, what is not printed is assumed."""

from __future__ import annotations

import math

from softgrip_design.errors import DesignError
from softgrip_model.finger import Finger, JointModel, MomentLaw, Strip
from softgrip_model.finger.published import HAND_MM, JOINT_LENGTH_MM, TANGENT_MODULUS_MPA, THUMB_METACARPAL_MM
from softgrip_model.profile import Cable, FingerDesign, Material, Profile

#: Order of the fingers in files and plots.
FINGERS = tuple(HAND_MM)
#: [mm] thickness and routing of section 4.2.3.
THICKNESS_BOUNDS_MM = (2.5, 5.0)
ROUTING_BOUNDS_MM = (5.0, 13.0)
#: [mm] assumed, as in the shipped profiles: depth of the body below the joints.
BODY_HEIGHT_MM = 12.0

CABLE = Cable(name="PE braid 0.25 mm", radius_m=0.000125, axial_stiffness_n=None, lead_length_m=0.0)


def blank(
    name: str, moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT, joint_model: JointModel = JointModel.FLEXURE
) -> Finger:
    """Return a finger of the hand with every design variable in the middle of its bounds.

    Raises:
        DesignError: the hand has no such finger.
    """
    if name not in HAND_MM:
        raise DesignError(f"expected a finger of the hand ({', '.join(FINGERS)}), found {name!r}")
    links, width = HAND_MM[name]
    return Finger(
        link_mm=links,
        thickness_mm=(sum(THICKNESS_BOUNDS_MM) / 2,) * len(links),
        length_mm=(JOINT_LENGTH_MM,) * len(links),
        routing_mm=(sum(ROUTING_BOUNDS_MM) / 2,) * (2 * len(links)),
        width_mm=width,
        strip=Strip(TANGENT_MODULUS_MPA, moment_law),
        base_mm=THUMB_METACARPAL_MM if name == "thumb" else 0.0,
        joint_model=joint_model,
        body_mm=BODY_HEIGHT_MM,
    )


def profile(identity: str, title: str, source: str, friction_id: str, fingers: dict[str, Finger]) -> Profile:
    """Return the finger set as a profile of schema 1; `softgrip_model.profile.save` checks and writes it.

    Args:
        identity: the profile's id and file name.
        title: for people.
        source: where the design comes from.
        friction_id: friction model it was designed with.
        fingers: slot -> design; all of one material.
    """
    strip = next(iter(fingers.values())).strip
    quadratic, linear, constant = (1e6 * value for value in strip.modulus_mpa)
    material = Material(
        name="NinjaFlex TPU 85A, printed",
        modulus_quadratic_pa=quadratic,
        modulus_linear_pa=linear,
        modulus_constant_pa=constant,
        moment_law=str(strip.moment_law),
        max_strain=strip.max_strain,
    )
    designs = tuple((slot, _design(finger)) for slot, finger in fingers.items())
    return Profile(1, identity, title, source, material, CABLE, friction_id, designs)


def _design(finger: Finger) -> FingerDesign:
    return FingerDesign(
        base_length_m=_m(finger.base_mm),
        link_lengths_m=tuple(map(_m, finger.link_mm)),
        width_m=_m(finger.width_mm),
        body_height_m=_m(BODY_HEIGHT_MM),
        joint_lengths_m=tuple(map(_m, finger.length_mm)),
        thicknesses_m=tuple(map(_m, finger.thickness_mm)),
        openings_rad=(math.pi / 2,) * finger.joints,
        routing_radii_m=tuple(map(_m, finger.routing_mm)),
        calibrated_path=(),
    )


def _m(length_mm: float) -> float:
    """Millimetres in metres, to the micrometre: finer than any printer."""
    return round(1e-3 * length_mm, 6)
