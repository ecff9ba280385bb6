# SPDX-License-Identifier: Apache-2.0
"""Motor, gear and spool of one servo: electrics, friction of the gear, heat (mechanics in src/plant/motor.hpp)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from softgrip_emulator.plant import _core

if TYPE_CHECKING:
    from softgrip_emulator.dynamixel.motion import ServoDrive
    from softgrip_emulator.dynamixel.servo import Shaft
    from softgrip_emulator.dynamixel.table import MotorRatings

AMBIENT_C: Final = _core.AMBIENT_C


class Motor(_core.Motor):
    """One geared motor that winds a tendon on a spool. `jammed` and `extra_heat_w` are what faults do to it."""

    def __init__(
        self, ratings: MotorRatings, shaft: Shaft, spool_radius_m: float, friction_factor: float = 1.0
    ) -> None:
        """Put a motor on a shaft.

        Args:
            ratings: of the servo model.
            shaft: shared with the servo.
            spool_radius_m: [m]
            friction_factor: gear friction of this copy relative to the ratings.
        """
        super().__init__(ratings, spool_radius_m, friction_factor)
        self.ratings = ratings
        self.shaft = shaft

    def step(self, drive: ServoDrive, tension_n: float, supply_v: float, dt_s: float) -> None:
        """Advance shaft, currents and temperatures by one step.

        Args:
            drive: duty and current limit from the servo's firmware.
            tension_n: pull of the tendon against winding [N].
            supply_v: voltage at the servo's terminals [V].
            dt_s: step [s].
        """
        shaft = self.shaft
        (
            shaft.angle_rad,
            shaft.velocity_rad_s,
            shaft.temperature_c,
            shaft.winding_c,
            shaft.current_a,
            shaft.duty,
        ) = self.turned(
            shaft.angle_rad,
            shaft.velocity_rad_s,
            shaft.temperature_c,
            shaft.winding_c,
            *drive,
            tension_n,
            supply_v,
            dt_s,
        )
        shaft.supply_v = supply_v
