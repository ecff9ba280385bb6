# SPDX-License-Identifier: Apache-2.0
"""The servo's control loop: goal through profile to duty cycle, once per plant step. Units are the registers'."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from softgrip_emulator.dynamixel.table import (
    ACCELERATION_UNIT_REV_PER_MIN2,
    PULSES_PER_TURN,
    PWM_FULL_SCALE,
    VELOCITY_UNIT_RPM,
)

if TYPE_CHECKING:
    from softgrip_emulator.dynamixel.registers import Registers

PULSES_PER_S_PER_VELOCITY_UNIT: Final = VELOCITY_UNIT_RPM * PULSES_PER_TURN / 60.0
_PULSES_PER_S2_PER_ACCELERATION_UNIT: Final = ACCELERATION_UNIT_REV_PER_MIN2 * PULSES_PER_TURN / 3600.0
_TIME_BASED: Final = 0x04
# e-manual, "Position PID Gain": K_P = P / 128, K_I = I / 65536, K_D = D / 16; "Velocity PI Gain": /128, /65536.
_P_SCALE, _I_SCALE, _D_SCALE = 1 / 128, 1 / 65536, 1 / 16
_LOOP_S: Final = 0.001
"""The gains are per cycle of the servo's own 1 kHz loop."""


class Mode(IntEnum):
    """Operating Mode (11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


POSITION_MODES: Final = frozenset({Mode.POSITION, Mode.EXTENDED_POSITION, Mode.CURRENT_BASED_POSITION})


@dataclass(frozen=True, slots=True)
class Drive:
    """What the power stage is told: duty cycle -1..1 and the largest current [A] it may let through."""

    duty: float = 0.0
    current_limit_a: float = 0.0


class Motion:
    """Profile generator and position/velocity loops of one servo."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._goal = 0.0
        self._integral = 0.0
        self.position = 0.0
        self.velocity = 0.0
        self.profile_active = False

    def restart(self, position: float) -> None:
        """Start from a standstill at `position` [pulse] (torque on, mode change, fold)."""
        self._goal = position
        self.position = position
        self.velocity = 0.0
        self._integral = 0.0
        self.profile_active = False

    def stop_at(self, position: float) -> None:
        """Hold where the shaft is (bus watchdog)."""
        self.restart(position)

    def drive(self, position: float, velocity: float, dt_s: float, *, follow: bool) -> Drive:
        """One step of the loop.

        Args:
            position: present position [pulse] in the host's counting direction.
            velocity: present velocity [pulse/s].
            dt_s: step [s].
            follow: take the goal from the registers (False after the bus watchdog has tripped).
        """
        get = self._registers.get
        mode = get("operating_mode")
        pwm_limit = get("pwm_limit") / PWM_FULL_SCALE
        current_limit_a = get("current_limit") * self._registers.model.motor.current_unit_a
        if mode in POSITION_MODES:
            if follow:
                self._goal = float(get("goal_position"))
            self._advance_profile(dt_s)
            duty = self._position_loop(position, velocity, dt_s)
            if mode == Mode.CURRENT_BASED_POSITION:
                current_limit_a = abs(get("goal_current")) * self._registers.model.motor.current_unit_a
            duty_limit = min(pwm_limit, abs(get("goal_pwm")) / PWM_FULL_SCALE)
        elif mode == Mode.VELOCITY:
            duty = self._velocity_loop(velocity, get("goal_velocity") if follow else 0, dt_s)
            duty_limit = min(pwm_limit, abs(get("goal_pwm")) / PWM_FULL_SCALE)
        elif mode == Mode.CURRENT:
            goal = get("goal_current") if follow else 0
            # A current source: as much voltage as it takes, in the direction asked for.
            return Drive(math.copysign(pwm_limit, goal), abs(goal) * self._registers.model.motor.current_unit_a)
        else:
            duty = get("goal_pwm") / PWM_FULL_SCALE if follow else 0.0
            duty_limit = pwm_limit
        return Drive(max(-duty_limit, min(duty_limit, duty)), current_limit_a)

    def _position_loop(self, position: float, velocity: float, dt_s: float) -> float:
        get = self._registers.get
        error = self.position - position
        gain_i = get("position_i_gain") * _I_SCALE
        self._integral = self._integral + error * dt_s / _LOOP_S if gain_i else 0.0
        pwm = (
            get("position_p_gain") * _P_SCALE * error
            + gain_i * self._integral
            + get("position_d_gain") * _D_SCALE * (self.velocity - velocity) * _LOOP_S
        )
        return pwm / PWM_FULL_SCALE

    def _velocity_loop(self, velocity: float, goal: int, dt_s: float) -> float:
        get = self._registers.get
        error = goal - velocity / PULSES_PER_S_PER_VELOCITY_UNIT
        self._integral += error * dt_s / _LOOP_S
        pwm = get("velocity_p_gain") * _P_SCALE * error + get("velocity_i_gain") * _I_SCALE * self._integral
        return pwm / PWM_FULL_SCALE

    def _advance_profile(self, dt_s: float) -> None:
        get = self._registers.get
        top, acceleration = get("profile_velocity"), get("profile_acceleration")
        remaining = self._goal - self.position
        if top == 0:
            # Profile Velocity 0: no profile, the goal is a step.
            self.position, self.velocity, self.profile_active = self._goal, 0.0, False
            return
        if get("drive_mode") & _TIME_BASED:
            # Time-based profile: the items are durations [ms]; here the span left shared over the time left.
            speed_limit = abs(remaining) / max(dt_s, top / 1000.0) if not self.profile_active else abs(self.velocity)
            rate = math.inf
        else:
            speed_limit = top * PULSES_PER_S_PER_VELOCITY_UNIT
            rate = acceleration * _PULSES_PER_S2_PER_ACCELERATION_UNIT if acceleration else math.inf
        if math.isfinite(rate):
            speed_limit = min(speed_limit, math.sqrt(2.0 * rate * abs(remaining)))
        wanted = math.copysign(speed_limit, remaining) if remaining else 0.0
        change = wanted - self.velocity
        if math.isfinite(rate):
            change = max(-rate * dt_s, min(rate * dt_s, change))
        self.velocity += change
        step = self.velocity * dt_s
        if abs(step) >= abs(remaining) and step * remaining >= 0:
            self.position, self.velocity, self.profile_active = self._goal, 0.0, False
        else:
            self.position += step
            self.profile_active = True
