# SPDX-License-Identifier: Apache-2.0
"""One printed finger as it really came out: the design plus what printing, cable and wear made of it, from a seed.

The predictor never sees these numbers, and none of its laws is here: strips are beams of fibres (plant/material.py),
the cable rubs by adhesion and pressure (rig/truth.py).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.plant.material import POISSON, fibre_law, relaxation
from softgrip_emulator.rig.truth import FrictionTruth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_model.profile import Cable, FingerDesign, Material

HOLE_RADIUS_M: Final = 0.6e-3
"""Of a hole that the profile does not state: the narrowest channel of softgrip_design's parts (docs/parts.md). Holes
come out of a printer some hundredths narrower than drawn."""


@dataclass(frozen=True)
class FingerTruth:
    """One real finger; arrays have one entry per joint (n) or per routing contact (2 n), base to tip."""

    profile: str
    serial: str
    base_length_m: float
    link_lengths_m: NDArray[np.float64]
    body_height_m: float
    opening_rad: NDArray[np.float64]
    entry_radius_m: NDArray[np.float64]
    exit_radius_m: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    """(2 n): how far the cable can move along the flank from the middle of its hole."""
    width_m: float
    strip_lengths_m: NDArray[np.float64]
    thickness_m: NDArray[np.float64]
    stress_tension_pa: NDArray[np.float64]
    stress_compression_pa: NDArray[np.float64]
    """(3,): nominal stress of a fibre = e (c1 + c2 e + c3 e^2) of the size e of its strain (plant/material.py)."""
    stiffness: NDArray[np.float64]
    """(n): how much stiffer than that each strip came out."""
    poisson: float
    damping_s: float
    """Viscous forces of a strip = damping_s times the rate of its elastic ones."""
    relaxing_share: NDArray[np.float64]
    relaxing_time_s: NDArray[np.float64]
    """(4,): Prony's series of the elastic forces (plant/material.py)."""
    softening: float
    """Share of the stiffness that a strip loses below a strain that it has had (Mullins' effect)."""
    friction_pressure: NDArray[np.float64]
    friction_adhesion: NDArray[np.float64]
    """(2 n): coefficient while sliding = pressure + adhesion / sqrt(tension) [1], [sqrt(N)] (rig/truth.py)."""
    bending_n: float
    bending_share: float
    """Tension that bending the cable round an edge costs, and straightening it again: a constant and a share."""
    friction_stribeck_share: float
    friction_stribeck_speed_m_s: float
    presliding_m: float
    """Cable travel over which friction turns round."""
    cable_stiffness_n: float
    """EA of the cable."""
    lead_length_m: float
    """Cable between spool and finger."""
    slack_m: float
    """Loose cable after mounting, before the spool has taken it up."""
    bedding_strain: float
    bedding_n: float
    """The braid becomes longer for good by this strain under tensions far above `bedding_n` [N]."""
    cable_creep_share: float
    cable_creep_time_s: float
    """The cable's elastic strain grows by this share in about this time, and comes back."""
    knot_slip_m: float
    """The knot gives so much for each e-fold of loadings [m]."""
    wear_per_j: NDArray[np.float64]
    """(2 n): by how much friction grows for each joule of pressing times sliding [1/J]."""
    mounting_roll_rad: float
    """How far the finger is turned about its own axis out of the plane that the camera is calibrated for."""
    cable_aside_m: NDArray[np.float64]
    """(n): how far beside the middle of the strip the cable crosses each groove."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.link_lengths_m)


def draw_finger(
    design: FingerDesign, material: Material, cable: Cable, *, profile: str, serial: str, seed: int
) -> FingerTruth:
    """Draw one finger. The same seed and serial give the same finger, whatever else was drawn before.

    Args:
        design: the finger as designed.
        material: its joint material as its data sheet says.
        cable: of its tendon, and the holes that it runs through.
        profile: id of the design's profile.
        serial: finger record number of this copy.
        seed: of the cell.
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"{profile}/{serial}".encode())])
    surface = FrictionTruth.from_seed(seed)
    joints = design.joints
    thickness = np.array(design.thicknesses_m) + rng.normal(0.0, 0.03e-3, joints)
    # A batch prints a little stiffer or softer than the data sheet, each joint scatters around that.
    stiffness = rng.normal(1.0, 0.05) * rng.normal(1.0, 0.025, joints)
    law, relaxing = fibre_law(material), relaxation(rng)
    # Across the cable a hole is a circle; the flank cuts it at half the groove's opening.
    hole_m = (cable.hole_radius_m or HOLE_RADIUS_M) + rng.normal(-0.05e-3, 0.03e-3)
    room = np.maximum(hole_m / np.cos(np.array(design.openings_rad) / 2.0) - cable.radius_m, 0.0)
    # The same cable on the same material as on the rig, a little rougher or smoother at each edge, which is rounder or
    # sharper than the rig's surface.
    rubbing = rng.normal(1.0, 0.03) * rng.normal(1.0, 0.05, 2 * joints)
    edge = rng.lognormal(0.0, 0.2, 2 * joints)
    radii = np.array(design.routing_radii_m) + rng.normal(0.0, 0.05e-3, 2 * joints)
    return FingerTruth(
        profile=profile,
        serial=serial,
        base_length_m=design.base_length_m,
        link_lengths_m=np.array(design.link_lengths_m) + rng.normal(0.0, 0.1e-3, joints),
        body_height_m=design.body_height_m,
        opening_rad=np.array(design.openings_rad),
        entry_radius_m=radii[0::2],
        exit_radius_m=radii[1::2],
        clearance_m=np.repeat(room, 2),
        width_m=design.width_m,
        strip_lengths_m=np.array(design.joint_lengths_m),
        thickness_m=thickness,
        stress_tension_pa=relaxing.at_once * law.tension_pa,
        stress_compression_pa=relaxing.at_once * law.compression_pa,
        stiffness=stiffness,
        poisson=POISSON,
        damping_s=0.035 * rng.uniform(0.8, 1.25),
        relaxing_share=relaxing.share,
        relaxing_time_s=relaxing.time_s,
        softening=rng.uniform(0.08, 0.22),
        friction_pressure=surface.pressure_coefficient * rubbing,
        friction_adhesion=surface.adhesion * rubbing * np.sqrt(edge),
        bending_n=surface.bending_n * rng.normal(1.0, 0.1),
        bending_share=surface.bending_share,
        friction_stribeck_share=0.08 * rng.uniform(0.5, 1.5),
        friction_stribeck_speed_m_s=1.5e-3,
        presliding_m=0.12e-3 * rng.uniform(0.7, 1.4),
        cable_stiffness_n=9.0e3 * rng.uniform(0.85, 1.15),
        lead_length_m=0.12,
        slack_m=rng.uniform(1.0e-3, 4.0e-3),
        bedding_strain=rng.uniform(1.0e-3, 4.0e-3),
        bedding_n=rng.uniform(6.0, 12.0),
        cable_creep_share=rng.uniform(0.10, 0.25),
        cable_creep_time_s=rng.uniform(20.0, 60.0),
        knot_slip_m=rng.uniform(0.01e-3, 0.05e-3),
        wear_per_j=rng.lognormal(np.log(4.0e-4), 0.8, 2 * joints),
        mounting_roll_rad=rng.normal(0.0, np.radians(1.0)),
        cable_aside_m=rng.normal(0.0, 0.1e-3, joints),
    )
