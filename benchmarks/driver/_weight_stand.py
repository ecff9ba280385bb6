# SPDX-License-Identifier: Apache-2.0
"""One emulated servo that lifts a weight on its tendon, in virtual time, under the driver's own backend."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import BusReply
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.plant.motor import AMBIENT_C, Motor
from softgrip_testing.virtual_bus import VirtualBus
from softgrip_testing.virtual_clock import VirtualClock

STEP_S = 0.001
#: [m] as designed
RADIUS_M = 0.010


class WeightStand(VirtualBus):
    """A servo, its motor, and a constant pull on its tendon; a group read takes 2 ms, everything else none.

    Args:
        model: of the servo.
        seed: of this copy: spool to 0.3 %, gear friction to a quarter, as in the emulated cell.
        limits_winding: which current the servo limits.
    """

    def __init__(self, model: str, seed: int, *, limits_winding: bool = False) -> None:
        self.servo = EmulatedServo(load_model(model), 1, limits_winding=limits_winding)
        clock = VirtualClock()
        super().__init__([self.servo], clock.now_s, clock)
        self._time = clock
        rng = Random(seed)
        self.motor = Motor(
            self.servo.model.motor, self.servo.shaft, RADIUS_M * rng.gauss(1.0, 0.003), rng.uniform(0.8, 1.25)
        )
        self.pull_n = 0.0
        self.supply_v = self.servo.model.motor.nominal_voltage_v
        self.warm(AMBIENT_C, AMBIENT_C)

    @property
    def now_s(self) -> float:
        """Time [s], the driver's and the servo's."""
        return self._time.now_s()

    def warm(self, winding_c: float, case_c: float) -> None:
        """Bring winding and case to temperatures [degC]."""
        self.servo.shaft.winding_c, self.servo.shaft.temperature_c = winding_c, case_c

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = self.now_s + duration_s - 0.5 * STEP_S
        while self.now_s < end_s:
            self._time.advance(self.now_s + STEP_S)
            self.servo.shaft.supply_v = self.supply_v
            self.motor.step(self.servo.step(self.now_s, STEP_S), self.pull_n, self.supply_v, STEP_S)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, BusReply]:
        """Read after 2 ms."""
        self.advance(0.002)
        return super().sync_read(servo_ids, address, size)

    def backend(self, servo: ServoConfiguration) -> DynamixelBackend:
        """Return a connected backend for a configuration of this servo."""
        backend = DynamixelBackend(self, [servo], watchdog=0.0)
        backend.connect()
        return backend
