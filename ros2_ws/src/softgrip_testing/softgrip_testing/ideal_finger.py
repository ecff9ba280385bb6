# SPDX-License-Identifier: Apache-2.0
"""An emulated finger with nothing but its strips: for tests that compare it with a closed form or another program."""

from __future__ import annotations

import numpy as np

from softgrip_emulator.plant.truth import FingerTruth


def ideal_finger(joints: int = 3) -> FingerTruth:
    """Return a finger without friction, clearance, relaxation, softening, creep, wear, roll or slack.

    E 21.89 MPa, width 13 mm, strips of 3 x 10 mm, links of 35 mm, cable 8.5 mm below the strips.
    """
    return FingerTruth(
        profile="ideal",
        serial="",
        base_length_m=0.0,
        link_lengths_m=np.full(joints, 0.035),
        body_height_m=0.012,
        opening_rad=np.full(joints, np.pi / 2),
        entry_radius_m=np.full(joints, 8.5e-3),
        exit_radius_m=np.full(joints, 8.5e-3),
        clearance_m=np.zeros(2 * joints),
        width_m=0.013,
        strip_lengths_m=np.full(joints, 0.010),
        thickness_m=np.full(joints, 0.003),
        stress_tension_pa=np.array([21.89e6, 0.0, 0.0]),
        stress_compression_pa=np.array([21.89e6, 0.0, 0.0]),
        stiffness=np.ones(joints),
        poisson=0.0,
        damping_s=1e-2,
        relaxing_share=np.zeros(4),
        relaxing_time_s=np.ones(4),
        softening=0.0,
        friction_pressure=np.zeros(2 * joints),
        friction_adhesion=np.zeros(2 * joints),
        bending_n=0.0,
        bending_share=0.0,
        friction_stribeck_share=0.0,
        friction_stribeck_speed_m_s=1e-3,
        presliding_m=1e-4,
        cable_stiffness_n=1e5,
        lead_length_m=0.0,
        slack_m=0.0,
        bedding_strain=0.0,
        bedding_n=1.0,
        cable_creep_share=0.0,
        cable_creep_time_s=1.0,
        knot_slip_m=0.0,
        wear_per_j=np.zeros(2 * joints),
        mounting_roll_rad=0.0,
        cable_aside_m=np.zeros(joints),
    )
