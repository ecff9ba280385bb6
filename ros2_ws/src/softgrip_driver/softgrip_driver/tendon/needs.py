# SPDX-License-Identifier: Apache-2.0
"""What a geared motor asks of a tendon's limits: friction hides tension, inertia feigns it, the stall ends it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.limits import LIMIT_PARAMETERS, TendonLimits
from softgrip_driver.tendon.units import Spool

#: share of the stall torque that a servo can hold until the driver backs off; from some three quarters on its own
#: overload shutdown may be quicker
LASTING_SHARE = 0.7
#: the same of servos that users saw shut down in seconds from some 0.4 on (docs/emulator.md)
EARLY_SHUTDOWN_SHARE = 0.36
#: [Hz] of the control loop, where nothing else is said
SHIPPED_LOOP_RATE = 100.0


@dataclass(frozen=True)
class TendonNeeds:
    """Limits of a tendon that a model's gears and inertia ask for, at the horn.

    Attributes:
        homing_torque: [N m] that homing must allow, or the friction of the gears hides where the tendon becomes taut.
        speed: [rad/s] up to which the data sheet's friction is good enough to feel a light finger.
        acceleration: [rad/s^2] up to which the motor's inertia does not pass for tension.
        loop_rate: [Hz] from which goals come smoothly enough: a stiff position control starts and stops with each one.
        lasting_share: of the stall torque, which no tension limit may exceed.
    """

    homing_torque: float
    speed: float
    acceleration: float
    loop_rate: float = 200.0
    lasting_share: float = LASTING_SHARE


class GearedMotor(Protocol):
    """A model of a servo or drive, at its horn."""

    @property
    def name(self) -> str:
        """Return its name."""

    @property
    def stall_torque(self) -> float:
        """Return the torque [N m] at stall."""

    @property
    def temperature_limit(self) -> float:
        """Return the temperature [degC] at which it lets go of everything."""

    @property
    def needs(self) -> TendonNeeds:
        """Return what it asks of the limits."""


def lasting_tension(motor: GearedMotor, radius: float) -> float:
    """Return the tension [N] that a motor on a spool of a radius [m] holds until the driver backs off."""
    return motor.needs.lasting_share * motor.stall_torque / radius


def fitted_limits(limits: TendonLimits, motor: GearedMotor, radius: float) -> TendonLimits:
    """Return limits that a motor on a spool of a radius [m] can keep, as near to the given ones as they can be."""
    homing = max(limits.homing_tension, motor.needs.homing_torque / radius)
    soft = min(limits.tension_soft, lasting_tension(motor, radius))
    return replace(
        limits,
        homing_tension=homing,
        tension_soft=max(homing, soft),
        speed=min(limits.speed, motor.needs.speed * radius),
        acceleration=min(limits.acceleration, motor.needs.acceleration * radius),
        temperature_limit=min(limits.temperature_limit, motor.temperature_limit),
    )


def required_limits(servos: Sequence[tuple[GearedMotor, float]]) -> dict[str, float | int]:
    """Return the parameters that servos on spools of a radius [m] ask for beyond what is shipped, by name.

    They are what `check_motor` would refuse the shipped ones for.
    """
    shipped = TendonLimits()
    minima = {
        "homing_tension": max(model.needs.homing_torque / radius for model, radius in servos),
        "loop_rate": max(model.needs.loop_rate for model, _ in servos),
    }
    maxima = {
        "speed": min(model.needs.speed * radius for model, radius in servos),
        "acceleration": min(model.needs.acceleration * radius for model, radius in servos),
        "tension_soft": min(lasting_tension(model, radius) for model, radius in servos),
        "temperature_limit": min(model.temperature_limit for model, _ in servos),
    }
    rounding = 1e-6
    found: dict[str, float | int] = {}
    for name, bound in minima.items():
        if bound > getattr(shipped, name, SHIPPED_LOOP_RATE) * (1.0 + rounding):
            found[LIMIT_PARAMETERS.get(name, name)] = math.ceil(bound * 1e4) / 1e4
    for name, bound in maxima.items():
        if bound < getattr(shipped, name) * (1.0 - rounding):
            found[LIMIT_PARAMETERS[name]] = math.floor(bound * 1e4) / 1e4
    return found


def check_motor(motor: GearedMotor, spool: Spool, limits: TendonLimits, loop_rate: float) -> None:
    """Raise ConfigurationError where a motor can not do what the parameters ask for.

    Args:
        motor: on the spool.
        spool: of the tendon.
        limits: of the tendon.
        loop_rate: [Hz] of the control loop.
    """
    if limits.temperature_limit > motor.temperature_limit:
        raise ConfigurationError(
            f"parameter {LIMIT_PARAMETERS['temperature_limit']}: expected at most the {motor.temperature_limit:g} degC "
            f"at which a {motor.name} lets go of everything, found {limits.temperature_limit:g}"
        )
    _check_needs(motor, spool, limits, loop_rate)
    lasting = lasting_tension(motor, spool.radius)
    if limits.tension_soft > lasting:
        raise ConfigurationError(
            f"parameter {LIMIT_PARAMETERS['tension_soft']}: expected at most {lasting:.1f} N, "
            f"{motor.needs.lasting_share:.0%} of a {motor.name}'s stall on a spool of {spool.radius * 1e3:g} mm, found "
            f"{limits.tension_soft:g}; with more it may shut down within seconds and let go"
        )


def _check_needs(motor: GearedMotor, spool: Spool, limits: TendonLimits, loop_rate: float) -> None:
    """Raise ConfigurationError where a model's gears and inertia can not do what the parameters ask for."""
    needs, radius = motor.needs, spool.radius
    minima = {
        LIMIT_PARAMETERS["homing_tension"]: (needs.homing_torque / radius, limits.homing_tension, "N"),
        "loop_rate": (needs.loop_rate, loop_rate, "Hz"),
    }
    maxima = {
        LIMIT_PARAMETERS["speed"]: (needs.speed * radius, limits.speed, "m/s"),
        LIMIT_PARAMETERS["acceleration"]: (needs.acceleration * radius, limits.acceleration, "m/s^2"),
    }
    rounding = 1e-6
    wrong = [
        f"{name} of at least {bound:.3g} {unit}, found {value:g}"
        for name, (bound, value, unit) in minima.items()
        if value < bound * (1.0 - rounding)
    ] + [
        f"{name} of at most {bound:.3g} {unit}, found {value:g}"
        for name, (bound, value, unit) in maxima.items()
        if value > bound * (1.0 + rounding)
    ]
    if wrong:
        raise ConfigurationError(
            f"a {motor.name} on a spool of {radius * 1e3:g} mm: expected {'; '.join(wrong)}; with others its gears and "
            "inertia would hide the tension of the tendon"
        )
