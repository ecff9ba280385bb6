# SPDX-License-Identifier: Apache-2.0
"""The motor's winding behind what a servo measures.

XL330 and XC330 sense the current of their power input, XL430 and XC430 none (ROBOTIS e-manual, notes of Current
Limit(38) and Goal Current(102)). Torque is made by the winding's current, which follows from what the power stage puts
out: duty V = R i + k_e w. What it takes in follows from the balance of power: V i_supply = R i^2 + k_e w i.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from softgrip_driver.errors import ConfigurationError

#: copper: share of its resistance at 25 degC that a kelvin adds (IEC 60028)
COPPER_PER_K = 0.00393
RATED_DEGC = 25.0
#: [K] by which the winding may be warmer than the servo's sensor where its currents do not show it
WINDING_ABOVE_SENSOR_STDDEV_K = 10.0
#: [K] of it that are believed at most
MIN_ABOVE_SENSOR_K, MAX_ABOVE_SENSOR_K = -10.0, 80.0
#: [s] after which what was seen of it is forgotten: small motors warm and cool within ten seconds or so
WARMTH_TIME_S = 20.0
#: [s] for which errors of voltage, speed and current stay the same: readings in between are one
WARMTH_CORRELATION_S = 5.0
#: [A] of the supply's current: a count, and a zero that may be off
SUPPLY_CURRENT_STDDEV = 0.002
#: resistances of no copper that works, by that at 25 degC: such a reading is of something else
MIN_RESISTANCE_RATIO, MAX_RESISTANCE_RATIO = 0.5, 2.0
#: share of its duty cycle by which a reading may differ from the one before to be a steady one
MAX_DUTY_CHANGE = 0.1
#: [V] a count of Present Input Voltage, and what the supply may have sagged since it was read
VOLTAGE_STDDEV = 0.05
#: [rad/s] a count of a Dynamixel's Present Velocity: a uniform distribution of that width
SPEED_STDDEV = 0.024 / math.sqrt(12.0)
#: resistance and back-EMF of one servo beside the data sheet's, relative
DATA_SHEET_STDDEV = 0.1
#: fewest readings for a fit, and the largest share of the resistance that its standard deviation may be
MIN_READINGS = 20
MAX_FIT_STDDEV = 0.2


@dataclass(frozen=True, kw_only=True)
class RatedMotor:
    """What a data sheet says of a servo's motor and gears.

    Attributes:
        rated_voltage: [V] at which the next three hold.
        stall_torque, stall_current, no_load_speed: [N m], [A], [rad/s]. Torque constant, resistance and back-EMF follow
            from them until `calibrate_tension` has measured them.
        no_load_current: [A] in the winding, needed to turn the gears without load: friction of the tension estimate.
    """

    rated_voltage: float
    stall_torque: float
    stall_current: float
    no_load_speed: float
    no_load_current: float

    @property
    def torque_per_ampere(self) -> float:
        """Torque constant seen at the horn [N m/A of the winding]."""
        return self.stall_torque / self.stall_current

    @property
    def resistance(self) -> float:
        """Resistance of the winding [ohm]."""
        return self.rated_voltage / self.stall_current

    @property
    def back_emf(self) -> float:
        """Back-EMF seen at the horn [V s/rad]."""
        return (self.rated_voltage - self.resistance * self.no_load_current) / self.no_load_speed


@dataclass(frozen=True)
class MotorReading:
    """What a servo shows of its motor, + as the tendon is pulled.

    Attributes:
        current: [A] Present Current, of the winding or of the supply, as the model senses it.
        duty: -1 .. 1 Present PWM.
        speed: [rad/s] of the shaft.
        voltage: [V] Present Input Voltage.
        temperature: [degC] of the servo's sensor.
    """

    current: float
    duty: float
    speed: float
    voltage: float
    temperature: float


@dataclass(frozen=True)
class Winding:
    """Resistance and back-EMF of a motor, seen at the horn.

    Attributes:
        resistance: R [ohm] at 25 degC.
        back_emf: k_e [V s/rad].
        relative_stddev: of both, this servo's from the values here.
        speed_stddev: [rad/s] of the speed that the servo reports.
    """

    resistance: float
    back_emf: float
    relative_stddev: float = DATA_SHEET_STDDEV
    speed_stddev: float = SPEED_STDDEV

    def resistance_at(self, temperature: float) -> float:
        """Return the resistance [ohm] at a temperature [degC]."""
        return self.resistance * (1.0 + COPPER_PER_K * (temperature - RATED_DEGC))

    def current(self, seen: MotorReading, warmth: WindingWarmth | None = None) -> tuple[float, float]:
        """Return the winding's current [A] and its standard deviation; none where the power stage is off.

        Args:
            seen: of the motor.
            warmth: what is known of how much warmer the winding is than the sensor; None: nothing.
        """
        if seen.duty == 0.0:
            return 0.0, 0.0
        warmth = warmth or WindingWarmth()
        ohm = self.resistance_at(seen.temperature + warmth.above_sensor_k)
        emf = self.back_emf * seen.speed
        current = (seen.duty * seen.voltage - emf) / ohm
        stddev = math.hypot(
            math.hypot(COPPER_PER_K * warmth.stddev_k, self.relative_stddev) * current,
            self.relative_stddev * emf / ohm,
            seen.duty * VOLTAGE_STDDEV / ohm,
            self.back_emf * self.speed_stddev / ohm,
        )
        return current, stddev

    def supply_current(self, current: float, speed: float, voltage: float, temperature: float) -> float:
        """Return the supply's current [A] while the winding carries ``current`` [A] at a shaft speed [rad/s]."""
        return current * (self.resistance_at(temperature) * current + self.back_emf * speed) / voltage


class WindingWarmth:
    """How much warmer the winding is than the servo's sensor, from the current of its supply.

    duty i = i_supply holds whatever the winding resists, so R = duty (duty V - k_e w) / i_supply is its resistance now,
    and copper tells its temperature by it. A Kalman filter of one state that goes back to nothing known: a small pull
    shows little, a large one, where it matters, much. A gain that the servo's current sensor is off by is in the
    calibrated resistance, too (`fit_winding`), and cancels.

    Attributes:
        above_sensor_k: [K] of the winding above the sensor.
    """

    def __init__(self) -> None:
        self.above_sensor_k = 0.0
        self._variance = WINDING_ABOVE_SENSOR_STDDEV_K**2
        self._seen_at_s = math.nan
        self._duty = 0.0

    @property
    def stddev_k(self) -> float:
        """Standard deviation of it [K]."""
        return math.sqrt(self._variance)

    def observe(self, winding: Winding, seen: MotorReading, now_s: float) -> None:
        """Take in a reading.

        Args:
            winding: calibrated.
            seen: of a servo that senses its supply.
            now_s: when.
        """
        passed_s = 0.0 if math.isnan(self._seen_at_s) else min(max(now_s - self._seen_at_s, 0.0), WARMTH_TIME_S)
        self._seen_at_s = now_s
        kept = math.exp(-passed_s / WARMTH_TIME_S)
        self.above_sensor_k *= kept
        self._variance = WINDING_ABOVE_SENSOR_STDDEV_K**2 + kept**2 * (
            self._variance - WINDING_ABOVE_SENSOR_STDDEV_K**2
        )
        is_steady = abs(seen.duty - self._duty) <= MAX_DUTY_CHANGE * abs(seen.duty)
        self._duty = seen.duty
        measured = _measured_warmth(winding, seen) if is_steady and passed_s > 0.0 else None
        if measured is None:
            return
        above_sensor_k, stddev_k = measured
        gain = self._variance / (self._variance + stddev_k**2 * max(1.0, WARMTH_CORRELATION_S / passed_s))
        moved = self.above_sensor_k + gain * (above_sensor_k - self.above_sensor_k)
        self.above_sensor_k = min(max(moved, MIN_ABOVE_SENSOR_K), MAX_ABOVE_SENSOR_K)
        self._variance *= 1.0 - gain


def _measured_warmth(winding: Winding, seen: MotorReading) -> tuple[float, float] | None:
    """Return what one reading shows of the winding above the sensor [K], and its standard deviation [K]; None: nothing.

    It shows nothing unless the supply drives the motor.
    """
    sign = math.copysign(1.0, seen.duty)
    duty, supply = abs(seen.duty), sign * seen.current
    emf = sign * winding.back_emf * seen.speed
    drop = duty * seen.voltage - emf
    if supply <= SUPPLY_CURRENT_STDDEV or drop <= 0.0:
        return None
    ratio = duty * drop / supply / winding.resistance
    if not MIN_RESISTANCE_RATIO <= ratio <= MAX_RESISTANCE_RATIO:
        return None
    relative = math.hypot(
        SUPPLY_CURRENT_STDDEV / supply,
        duty * VOLTAGE_STDDEV / drop,
        winding.back_emf * winding.speed_stddev / drop,
        winding.relative_stddev * emf / drop,
        winding.relative_stddev,
    )
    return (ratio - 1.0) / COPPER_PER_K + RATED_DEGC - seen.temperature, relative * ratio / COPPER_PER_K


def fit_winding(readings: Sequence[MotorReading], nominal: Winding) -> Winding:
    """Fit resistance and back-EMF to readings of a servo that senses its supply.

    i_supply = duty i = (duty^2 V - k_e duty w) / R is linear in 1/R and k_e/R. A gain that the servo's own sensor is
    off by goes into R and, the other way round, into the torque constant, and cancels in tensions and limits.

    Args:
        readings: while moving, in both directions and against a tension that varies.
        nominal: what the data sheet says; kept where the readings do not show it.

    Raises:
        ConfigurationError: too few readings, or none that show the two.
    """
    if len(readings) < MIN_READINGS:
        raise ConfigurationError(f"winding: expected at least {MIN_READINGS} readings, found {len(readings)}")
    rows = np.array([(r.current, r.duty, r.speed, r.voltage, r.temperature) for r in readings])
    supply, duty, speed, voltage, temperature = rows.T
    warmth = 1.0 + COPPER_PER_K * (temperature - RATED_DEGC)
    design = np.column_stack((duty * np.abs(duty) * voltage, -np.abs(duty) * speed)) / warmth[:, None]
    values, _, rank, _ = np.linalg.lstsq(design, supply, rcond=None)
    if rank < 2 or values[0] <= 0.0:
        raise ConfigurationError(
            f"winding: expected a supply current that grows with the duty cycle, found {values[0]:.3g} 1/ohm; wind in "
            "further, or to a higher tension"
        )
    residual = supply - design @ values
    covariance = float(residual @ residual) / (len(readings) - 2) * np.linalg.inv(design.T @ design)
    share = math.sqrt(covariance[0, 0]) / values[0]
    if share > MAX_FIT_STDDEV:
        raise ConfigurationError(
            f"winding: expected its resistance to better than {MAX_FIT_STDDEV:.0%}, found {share:.0%}; wind in to a "
            "higher tension"
        )
    return replace(
        nominal, resistance=float(1.0 / values[0]), back_emf=float(values[1] / values[0]), relative_stddev=share
    )
