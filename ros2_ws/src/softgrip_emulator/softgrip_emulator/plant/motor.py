# SPDX-License-Identifier: Apache-2.0
"""Motor, gear and spool of one servo: electrics, friction of the gear, heat. SI units at the output shaft."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from softgrip_emulator.dynamixel.motion import Drive
    from softgrip_emulator.dynamixel.servo import Shaft
    from softgrip_emulator.dynamixel.table import MotorRatings

AMBIENT_C = 24.0


@dataclass
class Motor:
    """One geared motor that winds a tendon on a spool."""

    ratings: MotorRatings
    shaft: Shaft
    spool_radius_m: float
    friction_factor: float = 1.0
    """Gear friction of this copy relative to the ratings."""
    extra_heat_w: float = 0.0
    jammed: bool = False

    def step(self, drive: Drive, tension_n: float, supply_v: float, dt_s: float) -> None:
        """Advance shaft, current and temperature by one step (semi-implicit Euler).

        Args:
            drive: duty and current limit from the servo's firmware.
            tension_n: pull of the tendon against winding [N].
            supply_v: voltage at the servo's terminals [V].
            dt_s: step [s].
        """
        ratings, shaft = self.ratings, self.shaft
        emf = ratings.back_emf_vs_per_rad * shaft.velocity_rad_s
        current = 0.0
        if drive.current_limit_a > 0.0 and drive.duty != 0.0:
            current = (drive.duty * supply_v - emf) / ratings.resistance_ohm
            current = max(-drive.current_limit_a, min(drive.current_limit_a, current))
        drive_nm = ratings.torque_constant_nm_per_a * current - tension_n * self.spool_radius_m
        velocity = shaft.velocity_rad_s + dt_s * drive_nm / ratings.inertia_kgm2
        velocity /= 1.0 + dt_s * ratings.gear_viscous_nms / ratings.inertia_kgm2
        # Coulomb friction as an impulse: it stops the shaft, never reverses it. The load presses the gear teeth.
        friction_nm = self.friction_factor * (ratings.gear_friction_nm + 0.06 * tension_n * self.spool_radius_m)
        impulse = dt_s * friction_nm / ratings.inertia_kgm2
        velocity = max(0.0, velocity - impulse) if velocity > 0.0 else min(0.0, velocity + impulse)
        if self.jammed:
            velocity = 0.0
        shaft.velocity_rad_s = velocity
        shaft.angle_rad += velocity * dt_s
        shaft.current_a = current
        shaft.duty = drive.duty
        shaft.supply_v = supply_v
        heat_w = current * current * ratings.resistance_ohm + self.extra_heat_w
        loss_w = (shaft.temperature_c - AMBIENT_C) / ratings.thermal_resistance_k_per_w
        shaft.temperature_c += dt_s * (heat_w - loss_w) / ratings.heat_capacity_j_per_k
