# SPDX-License-Identifier: Apache-2.0
"""One Feetech servo with a spool on it: lengths and forces on one side, units of the memory table on the other."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softgrip_driver.feetech import registers as reg
from softgrip_driver.feetech.registers import FeetechItem, FeetechModel
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.tendon.winding import RATED_DEGC, MotorReading, Winding


@dataclass(frozen=True)
class FeetechServo:
    """One servo of the configuration.

    Attributes:
        tendon: name of the tendon on its spool.
        servo_id: 0 .. 253.
        model: its motor.
        spool, torque, winding: between shaft and tendon.
        tension_hard: [N] the servo's own maximum torque is set a tenth above it.
        speed: [m/s] the servo's own speed limit is twice that of the setpoint.
        rad_per_s: [rad/s] of a speed unit; known after `identify`.
    """

    tendon: str
    servo_id: int
    model: FeetechModel
    spool: Spool
    torque: TorqueModel
    winding: Winding
    tension_hard: float
    speed: float
    rad_per_s: float = reg.RAD_PER_S_FINE

    def length(self, steps: int) -> float:
        """Return the tendon wound in [m] at a position [steps]."""
        return self.spool.length(steps * reg.RAD_PER_STEP)

    def steps(self, length: float) -> int:
        """Return the position [steps] at a length [m], within what the servo accepts."""
        return max(-reg.MAX_STEPS, min(reg.MAX_STEPS, round(self.spool.angle(length) / reg.RAD_PER_STEP)))

    @property
    def own_speed(self) -> float:
        """The servo's own speed limit [rad/s]."""
        return 2.0 * self.speed / self.spool.radius

    def speed_units(self, speed: float) -> int:
        """Return a speed [rad/s] as the servo takes it; 0 would be its fastest."""
        return max(1, math.ceil(speed / self.rad_per_s))

    def motor_reading(self, block: bytes) -> MotorReading:
        """Return what a cycle's block says of the motor, + as the tendon is pulled.

        The current comes without a sign from some firmware, so it takes that of the duty cycle.
        """
        sign = self.spool.direction
        duty = sign * value_in(block, reg.PRESENT_LOAD) / reg.FULL_SCALE
        return MotorReading(
            math.copysign(abs(value_in(block, reg.PRESENT_CURRENT)) * reg.AMPERE_PER_UNIT, duty),
            duty,
            sign * value_in(block, reg.PRESENT_SPEED) * self.rad_per_s,
            value_in(block, reg.PRESENT_VOLTAGE) * reg.VOLT_PER_UNIT,
            float(value_in(block, reg.PRESENT_TEMPERATURE)),
        )

    def standing(self) -> MotorReading:
        """Return what is assumed of a motor until it has been read: at rest, on its rated supply, cool."""
        return MotorReading(0.0, 0.0, 0.0, self.model.rated_voltage, RATED_DEGC)

    def pull(self, seen: MotorReading) -> tuple[float, float, float]:
        """Return the winding's current [A], and the force [N] on the tendon with its standard deviation [N].

        From the duty cycle, not from the current that the servo measures: in steps of 6.5 mA, and by a sensor whose
        place no maker's document shows.
        """
        current, stddev = self.winding.current(seen)
        radius = self.spool.radius
        return current, *self.torque.pull(current, seen.speed * radius, radius, stddev)

    def duty_units(self, tension: float, seen: MotorReading) -> int:
        """Return the torque limit for a tension limit [N]: the duty cycle that makes the current, at the shaft's speed.

        A motor that is stopped needs less, which is known after one cycle.
        """
        speed = max(0.0, min(seen.speed, self.speed / self.spool.radius))
        voltage = max(seen.voltage, self.model.voltage_range[0])
        current = self.torque.current(tension, self.spool.radius)
        volts = self.winding.resistance_at(seen.temperature) * current + self.winding.back_emf * speed
        return max(1, min(reg.FULL_SCALE, round(reg.FULL_SCALE * volts / voltage)))

    @property
    def max_torque_units(self) -> int:
        """The servo's own maximum torque: a tenth above the hard tension limit, on a weak supply, at full speed."""
        fastest = MotorReading(0.0, 0.0, self.speed / self.spool.radius, self.model.voltage_range[0], RATED_DEGC)
        return self.duty_units(1.1 * self.tension_hard, fastest)


def value_in(block: bytes, item: FeetechItem) -> int:
    """Return an item of a cycle's block."""
    start = item.address - reg.CYCLE_BLOCK[0]
    return item.decode(block[start : start + item.size])
