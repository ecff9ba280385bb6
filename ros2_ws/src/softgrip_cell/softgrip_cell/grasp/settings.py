# SPDX-License-Identifier: Apache-2.0
"""What a grasp is judged by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GraspSettings:
    """Thresholds of the grasp sequence, the same for every product.

    Attributes:
        contact_sigma: excess tension in standard deviations of the free motion that is taken for contact.
        contact_floor_n: and never less than this [N].
        contact_free_fraction: and never less than this share of the free tension, which the table repairs only so far.
        length_error_m: error of the pulled length between two closings: where the free tension rises steeply it looks
            like contact [m].
        end_free_fraction: and never less than this share of it where the checked path ends, within end_m of it: there
            the grooves close, and the table is from a few samples.
        end_m: see end_free_fraction [m].
        contact_from_m: pulled length from which contact is looked for: before, slack and the motor's start hide it [m].
        run: samples in a row that have to agree before anything is decided.
        min_blockage_m: a finger that stopped so far short of its end is blocked; nearer, its own stops may hold it [m].
        tip_m: a fingertip that is seen farther than this from its predicted place, beside the camera's own uncertainty,
            leans on something; what the check after a swap lets pass, twice as far beyond the path that it covered [m].
        slip_share: share of the contact threshold below which a finger that held touches nothing any more.
        slip_s: how long a hold has to be lost before it counts [s].
        lost_fraction: measured tension below this share of the free tension is a tendon that pulls nothing.
        lost_floor_n: free tension from which that can be judged [N].
        lost_s: how long it has to pull nothing: the drive's tension is no good while it gets up to speed [s].
        press_speed_m_per_s: pulled length per second once both sides touch and only force is missing [m/s].
        settle_s: after both sides touched, how long the fingers may take until they stand and press [s].
        lift_window_s: how long the hold is watched after lifting (thesis 4.3.3: 5 s) [s].
        stale_s: longest run of samples without a prediction [s].
        open_m: pulled length below which a finger counts as open [m].
        reach_m: distance to the end of the path that counts as there [m].
        tension_limit_n: largest tension that is ever asked of the driver [N].
        lever_factor: how much greater the force of a contact nearer to the base may be than at the fingertip.
    """

    contact_sigma: float = 5.0
    contact_floor_n: float = 0.35
    contact_free_fraction: float = 0.03
    length_error_m: float = 0.0003
    end_free_fraction: float = 0.12
    end_m: float = 0.0015
    contact_from_m: float = 0.003
    run: int = 3
    min_blockage_m: float = 0.0008
    tip_m: float = 0.012
    slip_share: float = 0.7
    slip_s: float = 0.04
    lost_fraction: float = 0.35
    lost_floor_n: float = 4.0
    lost_s: float = 0.2
    press_speed_m_per_s: float = 0.03
    settle_s: float = 0.8
    lift_window_s: float = 5.0
    stale_s: float = 0.25
    open_m: float = 0.0015
    reach_m: float = 0.0003
    tension_limit_n: float = 35.0
    lever_factor: float = 2.0
