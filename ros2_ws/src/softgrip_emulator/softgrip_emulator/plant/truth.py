# SPDX-License-Identifier: Apache-2.0
"""One printed finger as it really came out: the design plus what printing, cable and wear made of it, from a seed.

The predictor never sees these numbers. Nothing here is its friction law: friction is a capstan whose coefficient
falls with tension as a power law, rises at low sliding speed (Stribeck) and scatters from contact to contact.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from softgrip_emulator.plant.surface import surface_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_model.profile import FingerDesign, Material


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
    moment_coefficients: NDArray[np.float64]
    """(3, n): torque = c0 q + c1 q|q| + c2 q^3 [N m] (thesis section 4.2.2, tangent modulus of |strain| integrated)."""
    damping_s: float
    """Viscous torque = damping_s * c0 * dq/dt."""
    creep_share: float
    """Share of the elastic torque that relaxes."""
    creep_time_s: float
    friction_coefficient: NDArray[np.float64]
    """(2 n): coefficient at 5 N while sliding."""
    friction_tension_exponent: float
    friction_stribeck_share: float
    friction_stribeck_speed_m_s: float
    friction_bite: NDArray[np.float64]
    """(2 n): part of ln(T1/T2) that does not depend on the wrap angle, reached once the cable lies on the edge."""
    presliding_m: float
    """Cable travel over which friction turns round."""
    cable_stiffness_n: float
    """EA of the cable."""
    lead_length_m: float
    """Cable between spool and finger."""
    slack_m: float
    """Loose cable after mounting, before the spool has taken it up."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.link_lengths_m)


def draw_finger(design: FingerDesign, material: Material, *, profile: str, serial: str, seed: int) -> FingerTruth:
    """Draw one finger. The same seed and serial give the same finger, whatever else was drawn before.

    Args:
        design: the finger as designed.
        material: its joint material as its data sheet says.
        profile: id of the design's profile.
        serial: finger record number of this copy.
        seed: of the cell.
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"{profile}/{serial}".encode())])
    surface = surface_of(seed)
    joints = design.joints
    width, length = design.width_m, np.array(design.joint_lengths_m)
    thickness = np.array(design.thicknesses_m) + rng.normal(0.0, 0.03e-3, joints)
    # A batch prints a little stiffer or softer than the data sheet, each joint scatters around that.
    stiffness = rng.normal(1.0, 0.05) * rng.normal(1.0, 0.025, joints)
    half = thickness / 2.0
    moment = (
        2.0
        * width
        * stiffness
        * np.stack(
            [
                material.modulus_constant_pa * half**3 / 3.0 / length,
                material.modulus_linear_pa * half**4 / 8.0 / length**2,
                material.modulus_quadratic_pa * half**5 / 15.0 / length**3,
            ]
        )
    )
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
        moment_coefficients=moment,
        damping_s=0.035 * rng.uniform(0.8, 1.25),
        creep_share=0.10 * rng.uniform(0.7, 1.3),
        creep_time_s=6.0 * rng.uniform(0.7, 1.4),
        friction_coefficient=surface.coefficient * rng.normal(1.0, 0.03) * rng.normal(1.0, 0.05, 2 * joints),
        friction_tension_exponent=surface.exponent,
        friction_stribeck_share=0.08 * rng.uniform(0.5, 1.5),
        friction_stribeck_speed_m_s=1.5e-3,
        friction_bite=surface.bite * rng.normal(1.0, 0.15, 2 * joints),
        presliding_m=0.12e-3 * rng.uniform(0.7, 1.4),
        cable_stiffness_n=9.0e3 * rng.uniform(0.85, 1.15),
        lead_length_m=0.12,
        slack_m=rng.uniform(1.0e-3, 4.0e-3),
    )
