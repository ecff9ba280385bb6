# SPDX-License-Identifier: Apache-2.0
"""The servo's control loop: goal through profile to duty cycle, once per plant step. Units are the registers'."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

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


class ServoMode(IntEnum):
    """Operating Mode (11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


POSITION_MODES: Final = frozenset({ServoMode.POSITION, ServoMode.EXTENDED_POSITION, ServoMode.CURRENT_BASED_POSITION})


class ServoDrive(NamedTuple):
    """What the power stage is told: duty cycle -1..1 and the largest current [A] it may let through.

    The limit is one of the supply's current where `limits_supply` is set, else of the winding's.
    """

    duty: float = 0.0
    current_limit_a: float = 0.0
    limits_supply: bool = False


class _Settings(NamedTuple):
    """What the loop is set to, decoded from the registers."""

    mode: int
    pwm_limit: float
    duty_limit: float
    current_limit_a: float
    goal_position: float
    goal_velocity: int
    goal_current: int
    goal_current_a: float
    goal_duty: float
    position_p: float
    position_i: float
    position_d: float
    velocity_p: float
    velocity_i: float
    profile_top: int
    """Profile Velocity: [velocity unit], or a duration [ms] in a time-based profile."""
    profile_rate: float
    """[pulse/s^2]"""
    time_based: bool

    @classmethod
    def decoded(cls, registers: Registers) -> _Settings:
        get, unit_a, has_current = registers.get, registers.model.motor.current_unit_a, registers.has("goal_current")
        goal_current = get("goal_current") if has_current else 0
        pwm_limit = get("pwm_limit") / PWM_FULL_SCALE
        goal_duty = get("goal_pwm") / PWM_FULL_SCALE
        time_based = bool(get("drive_mode") & _TIME_BASED)
        acceleration = get("profile_acceleration")
        limited = acceleration and not time_based
        return cls(
            mode=get("operating_mode"),
            pwm_limit=pwm_limit,
            duty_limit=min(pwm_limit, abs(goal_duty)),
            current_limit_a=get("current_limit") * unit_a if has_current else math.inf,
            goal_position=float(get("goal_position")),
            goal_velocity=get("goal_velocity"),
            goal_current=goal_current,
            goal_current_a=abs(goal_current) * unit_a,
            goal_duty=goal_duty,
            position_p=get("position_p_gain") * _P_SCALE,
            position_i=get("position_i_gain") * _I_SCALE,
            position_d=get("position_d_gain") * _D_SCALE,
            velocity_p=get("velocity_p_gain") * _P_SCALE,
            velocity_i=get("velocity_i_gain") * _I_SCALE,
            profile_top=get("profile_velocity"),
            profile_rate=acceleration * _PULSES_PER_S2_PER_ACCELERATION_UNIT if limited else math.inf,
            time_based=time_based,
        )


class ServoMotion:
    """Profile generator and position/velocity loops of one servo."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._settings = _Settings.decoded(registers)
        self._decoded_at = registers.changes
        self._goal = 0.0
        self._integral = 0.0
        self.position = 0.0
        self.velocity = 0.0
        self.profile_active = False
        self.stiffness = 1.0
        """Of position control, relative to the e-manual's; Rhoban's bam project saw half of it on an XL330."""

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

    def drive(self, position: float, velocity: float, dt_s: float, *, follow: bool) -> ServoDrive:
        """One step of the loop.

        Args:
            position: present position [pulse] in the host's counting direction.
            velocity: present velocity [pulse/s].
            dt_s: step [s].
            follow: take the goal from the registers (False after the bus watchdog has tripped).
        """
        if self._decoded_at != self._registers.changes:
            self._settings = _Settings.decoded(self._registers)
            self._decoded_at = self._registers.changes
        settings = self._settings
        mode, duty_limit, current_limit_a = settings.mode, settings.duty_limit, settings.current_limit_a
        if mode in POSITION_MODES:
            if follow:
                self._goal = settings.goal_position
            self._advance_profile(settings, dt_s)
            duty = self._position_loop(settings, position, velocity, dt_s)
            if mode == ServoMode.CURRENT_BASED_POSITION:
                current_limit_a = settings.goal_current_a
        elif mode == ServoMode.VELOCITY:
            duty = self._velocity_loop(settings, velocity, settings.goal_velocity if follow else 0, dt_s)
        elif mode == ServoMode.CURRENT:
            # A current source: as much voltage as it takes, in the direction asked for.
            if not follow:
                return ServoDrive(settings.pwm_limit, 0.0)
            return ServoDrive(math.copysign(settings.pwm_limit, settings.goal_current), settings.goal_current_a)
        else:
            duty = settings.goal_duty if follow else 0.0
            duty_limit = settings.pwm_limit
        return ServoDrive(max(-duty_limit, min(duty_limit, duty)), current_limit_a)

    def _position_loop(self, settings: _Settings, position: float, velocity: float, dt_s: float) -> float:
        error = self.position - position
        self._integral = self._integral + error * dt_s / _LOOP_S if settings.position_i else 0.0
        pwm = (
            self.stiffness * settings.position_p * error
            + settings.position_i * self._integral
            + settings.position_d * (self.velocity - velocity) * _LOOP_S
        )
        return pwm / PWM_FULL_SCALE

    def _velocity_loop(self, settings: _Settings, velocity: float, goal: int, dt_s: float) -> float:
        error = goal - velocity / PULSES_PER_S_PER_VELOCITY_UNIT
        self._integral += error * dt_s / _LOOP_S
        pwm = settings.velocity_p * error + settings.velocity_i * self._integral
        return pwm / PWM_FULL_SCALE

    def _advance_profile(self, settings: _Settings, dt_s: float) -> None:
        remaining = self._goal - self.position
        top, rate = settings.profile_top, settings.profile_rate
        if top == 0:
            # Profile Velocity 0: no profile, the goal is a step.
            self.position, self.velocity, self.profile_active = self._goal, 0.0, False
            return
        if settings.time_based:
            # Time-based profile: the items are durations [ms]; here the span left shared over the time left.
            speed_limit = abs(remaining) / max(dt_s, top / 1000.0) if not self.profile_active else abs(self.velocity)
        else:
            speed_limit = top * PULSES_PER_S_PER_VELOCITY_UNIT
        if math.isfinite(rate):
            speed_limit = min(speed_limit, math.sqrt(2.0 * rate * abs(remaining)))
        requested = math.copysign(speed_limit, remaining) if remaining else 0.0
        change = requested - self.velocity
        if math.isfinite(rate):
            change = max(-rate * dt_s, min(rate * dt_s, change))
        self.velocity += change
        step = self.velocity * dt_s
        if abs(step) >= abs(remaining) and step * remaining >= 0:
            self.position, self.velocity, self.profile_active = self._goal, 0.0, False
        else:
            self.position += step
            self.profile_active = True
