# SPDX-License-Identifier: Apache-2.0
"""From a table of plain values (the node's parameters, or a command's options) to checked settings."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import BAUD_CODES, MODELS, CurrentSensing, OperatingMode, ServoModel
from softgrip_driver.dynamixel.winding import Winding
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig.build import GAUGES, STAGES, StreamSettings, make_gauge, make_stage, stream_settings
from softgrip_driver.rig.grbl import StageStart
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.gripper import Block, GripperController, Policies, StopPolicy, never_blocked
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_time import Clock

Value = TypeVar("Value")

#: parameter name of each limit: its quantity and unit
LIMIT_PARAMETERS: dict[str, str] = {
    "travel": "travel_m",
    "speed": "speed_m_s",
    "acceleration": "acceleration_m_s2",
    "release_speed": "release_speed_m_s",
    "tension_soft": "tension_soft_n",
    "tension_hard": "tension_hard_n",
    "tension_slack": "tension_slack_n",
    "tension_hold": "tension_hold_n",
    "slack_travel": "slack_travel_m",
    "break_drop_from": "break_drop_from_n",
    "break_confirm": "break_confirm_s",
    "stall_time": "stall_time_s",
    "max_following_error": "max_following_error_m",
    "position_tolerance": "position_tolerance_m",
    "tension_tolerance": "tension_tolerance",
    "temperature_limit": "temperature_limit_degc",
    "no_reply": "no_reply_s",
    "homing_tension": "homing_tension_n",
    "homing_speed": "homing_speed_m_s",
    "homing_travel": "homing_travel_m",
    "homing_timeout": "homing_timeout_s",
}


#: what may pull the tendons: servos on a bus, or one tendon on a stage
BACKENDS = ("dynamixel", *STAGES)
#: [Hz] that a stage can be asked and told: GRBL's documentation asks for 5 and allows 10; the stand takes some 10 ms an
#: order
STAGE_RATES = {"grbl": 10.0, "mark10": 20.0}
#: a stage is this much faster than the fastest setpoint, so that it keeps up
STAGE_SPEED_FACTOR = 1.2
#: share of the stall torque that a servo can hold until the driver backs off; from some three quarters on its own
#: overload shutdown may be quicker
LASTING_SHARE = 0.7
#: [Hz] of the control loop, where nothing else is said
SHIPPED_LOOP_RATE = 100.0
#: periods of the loop that the servos' bus watchdog lasts at least
WATCHDOG_PERIODS = 2.0


@dataclass(frozen=True)
class TendonGaugeSettings:
    """The force gauge in a stage's tendon.

    Attributes:
        kind: of GAUGES. port: serial. stream: how to read one that speaks in lines.
        proof: [N] that a hand must pull before anything is wound in; 0 = none.
    """

    kind: str
    port: str
    stream: StreamSettings
    proof: float


@dataclass(frozen=True)
class DriverConfiguration:
    """Everything the tendon driver needs to know.

    Attributes:
        kind: one of BACKENDS.
        port, baud, reply_margin: of the bus, or of the stage, whose baud rate is fixed.
        servos: one for each tendon; none with a stage.
        spools: by tendon.
        gauge: in the tendon of a stage; None with servos.
        stage_start: what to do where a stage is locked when it is opened.
        limits: by tendon.
        grippers: by tendon, the gripper it belongs to.
        policies: of the whole gripper.
        loop_rate: [Hz]
        bus_watchdog: [s]
        write_eeprom: correct persistent settings.
        zero_file: None keeps no zeros.
        safety_file: the emergency stop and the lock on disk.
    """

    kind: str
    port: str
    baud: int
    reply_margin: float
    servos: tuple[ServoConfiguration, ...]
    spools: Mapping[str, Spool]
    gauge: TendonGaugeSettings | None
    stage_start: StageStart
    limits: Mapping[str, TendonLimits]
    grippers: Mapping[str, str]
    policies: Policies
    loop_rate: float
    bus_watchdog: float
    write_eeprom: bool
    zero_file: Path | None
    safety_file: Path

    def controller(self, block: Callable[[], Block | None] = never_blocked) -> GripperController:
        """Return the controller, knowing nothing yet; ``block`` says whether anything may move."""
        return GripperController(self.limits, self.policies, self.grippers, 1.0 / self.loop_rate, block)

    def backend(self, report: Callable[[str], object], clock: Clock) -> TendonBackend:
        """Return the backend, not connected; ``report`` is told what it is about to change in a device for good.

        It waits on ``clock``.
        """
        if self.gauge is not None:
            ((tendon, limits),) = self.limits.items()
            stage = make_stage(self.kind, self.port, self.reply_margin, self.stage_start, clock)
            gauge = make_gauge(self.gauge.kind, self.gauge.port, self.gauge.stream, self.reply_margin, clock)
            return StageBackend(tendon, stage, gauge, STAGE_SPEED_FACTOR * limits.speed, self.gauge.proof, clock)
        bus = Bus(self.port, self.baud, self.reply_margin, clock)
        return DynamixelBackend(
            bus,
            self.servos,
            self.bus_watchdog,
            write_eeprom=self.write_eeprom,
            report=report,
            hold_unwatched=self.policies.unclean_end is StopPolicy.HOLD,
        )


def checked_configuration(values: Mapping[str, Any]) -> DriverConfiguration:
    """Return the configuration that a table of values describes.

    Args:
        values: parameter name to value; lists of per-tendon values have one element for each tendon, or one for all.

    Raises:
        ConfigurationError: values that contradict each other.
    """
    tendons = list(values["tendons"])
    if not tendons or not all(tendons) or len(set(tendons)) != len(tendons):
        raise ConfigurationError(f"parameter tendons: expected names that differ, found {tendons}")
    if values["baud"] not in BAUD_CODES:
        raise ConfigurationError(f"parameter baud: expected one of {list(BAUD_CODES)}, found {values['baud']}")
    limits = _limits(values)
    on_bus = values["backend"] == "dynamixel"
    if on_bus and 0.0 < values["bus_watchdog_s"] < WATCHDOG_PERIODS / values["loop_rate"]:
        raise ConfigurationError(
            f"parameter bus_watchdog_s: expected 0, or at least {WATCHDOG_PERIODS:g} periods of the loop of "
            f"{values['loop_rate']:g} Hz, found {values['bus_watchdog_s']:g}; servos would stop between two orders"
        )
    spools = [
        Spool(radius, direction)
        for radius, direction in zip(
            _per_tendon(values, "spool_radii_m", tendons), _per_tendon(values, "directions", tendons), strict=True
        )
    ]
    return DriverConfiguration(
        kind=values["backend"],
        port=values["port"],
        baud=values["baud"],
        reply_margin=values["reply_margin_s"],
        servos=_servos(values, tendons, spools, limits) if on_bus else (),
        spools=dict(zip(tendons, spools, strict=True)),
        gauge=None if on_bus else _gauge(values, tendons),
        stage_start=StageStart(values["stage_start"]),
        limits=dict.fromkeys(tendons, limits),
        grippers=dict(zip(tendons, _per_tendon(values, "grippers", tendons), strict=True)),
        policies=Policies(
            estop=StopPolicy[values["estop_policy"].upper()],
            unclean_end=StopPolicy[values["unclean_end_policy"].upper()],
            command_timeout=values["command_timeout_s"],
            release_after=values["release_after_s"],
            stream_timeout=values["stream_timeout_s"],
            lease_max=values["lease_max_s"],
            continuous_tension=values["continuous_tension_n"],
        ),
        loop_rate=values["loop_rate"],
        bus_watchdog=values["bus_watchdog_s"],
        write_eeprom=values["write_eeprom"],
        zero_file=Path(values["zero_file"]).expanduser() if values["zero_file"] else None,
        safety_file=_safety_file(values),
    )


def _safety_file(values: Mapping[str, Any]) -> Path:
    """Return where emergency stop and lock are kept: as given, else one file for each port in the user's ROS folder.

    There is no way to keep them nowhere: a stop that a restart forgets is none.
    """
    if values["safety_file"]:
        return Path(values["safety_file"]).expanduser()
    home = Path(os.environ.get("ROS_HOME") or "~/.ros").expanduser()
    port = "".join(character if character.isalnum() else "-" for character in values["port"]).strip("-")
    return home / "softgrip" / f"tendon_safety-{port}.yaml"


def _limits(values: Mapping[str, Any]) -> TendonLimits:
    return TendonLimits(**{field.name: values[LIMIT_PARAMETERS[field.name]] for field in fields(TendonLimits)})


def _gauge(values: Mapping[str, Any], tendons: Sequence[str]) -> TendonGaugeSettings:
    """Return the gauge of a stage, and check what a stage asks of the rest."""
    kind, rate = values["backend"], values["loop_rate"]
    if len(tendons) != 1:
        raise ConfigurationError(f"parameter tendons: expected one with backend '{kind}', found {list(tendons)}")
    if not values["gauge_port"] or values["gauge"] not in GAUGES:
        raise ConfigurationError(
            f"parameters gauge, gauge_port: expected a gauge of {list(GAUGES)} and its port with backend '{kind}', "
            f"found '{values['gauge']}' and '{values['gauge_port']}'; without one nobody knows the tension"
        )
    if rate > STAGE_RATES[kind]:
        raise ConfigurationError(
            f"parameter loop_rate: expected at most {STAGE_RATES[kind]:g} Hz with backend '{kind}', found {rate:g}"
        )
    return TendonGaugeSettings(values["gauge"], values["gauge_port"], stream_settings(values), values["gauge_proof_n"])


def _servos(
    values: Mapping[str, Any], tendons: Sequence[str], spools: Sequence[Spool], limits: TendonLimits
) -> tuple[ServoConfiguration, ...]:
    ids = _per_tendon(values, "servo_ids", tendons)
    if len(set(ids)) != len(ids):
        raise ConfigurationError(f"parameter servo_ids: expected each ID once, found {ids}")
    return tuple(_servo(values, tendons, index, spools[index], limits) for index in range(len(tendons)))


def _servo(
    values: Mapping[str, Any], tendons: Sequence[str], index: int, spool: Spool, limits: TendonLimits
) -> ServoConfiguration:
    def own(name: str) -> Any:
        return _per_tendon(values, name, tendons)[index]

    name = own("servo_models")
    if name not in MODELS:
        raise ConfigurationError(f"parameter servo_models: expected names out of {sorted(MODELS)}, found '{name}'")
    model = MODELS[name]
    if limits.temperature_limit > model.temperature_limit:
        raise ConfigurationError(
            f"parameter {LIMIT_PARAMETERS['temperature_limit']}: expected at most the {model.temperature_limit:g} degC "
            f"at which a {name} lets go of everything, found {limits.temperature_limit:g}"
        )
    _check_needs(model, spool, limits, values["loop_rate"])
    mode = OperatingMode(values["operating_mode"])
    if model.senses is CurrentSensing.NONE and mode is OperatingMode.CURRENT_BASED_POSITION:
        raise ConfigurationError(
            f"parameter operating_mode: expected 4 with a {name}, which knows no current, found {mode.value}; then the "
            "driver alone limits the tension"
        )
    lasting = LASTING_SHARE * model.stall_torque / spool.radius
    if limits.tension_soft > lasting:
        raise ConfigurationError(
            f"parameter {LIMIT_PARAMETERS['tension_soft']}: expected at most {lasting:.1f} N, {LASTING_SHARE:.0%} of a "
            f"{name}'s stall on a spool of {spool.radius * 1e3:g} mm, found {limits.tension_soft:g}; with more it may "
            "shut down within seconds and let go"
        )
    return ServoConfiguration(
        tendons[index],
        own("servo_ids"),
        model,
        spool,
        _torque(own, model),
        mode,
        limits.tension_hard,
        limits.speed,
        _winding(own),
        CurrentSensing(own("limited_currents")) if model.senses is CurrentSensing.SUPPLY else None,
    )


def required_parameters(servos: Sequence[tuple[ServoModel, float]]) -> dict[str, float | int]:
    """Return the parameters that servos on spools of a radius [m] ask for beyond what is shipped, by name.

    They are what `checked_configuration` would refuse the shipped ones for.
    """
    shipped = TendonLimits()
    minima = {
        "homing_tension": max(model.needs.homing_torque / radius for model, radius in servos),
        "loop_rate": max(model.needs.loop_rate for model, _ in servos),
    }
    maxima = {
        "speed": min(model.needs.speed * radius for model, radius in servos),
        "acceleration": min(model.needs.acceleration * radius for model, radius in servos),
        "tension_soft": min(LASTING_SHARE * model.stall_torque / radius for model, radius in servos),
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
    if any(model.senses is CurrentSensing.NONE for model, _ in servos):
        found["operating_mode"] = OperatingMode.EXTENDED_POSITION.value
    return found


def _check_needs(model: ServoModel, spool: Spool, limits: TendonLimits, loop_rate: float) -> None:
    """Raise ConfigurationError where a model's gears and inertia can not do what the parameters ask for."""
    needs, radius = model.needs, spool.radius
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
            f"a {model.name} on a spool of {radius * 1e3:g} mm: expected {'; '.join(wrong)}; with others its gears and "
            "inertia would hide the tension of the tendon"
        )


def _torque(own: Callable[[str], Any], model: ServoModel) -> TorqueModel:
    """Return what a tendon's own values say of its servo's torque, else what the data sheet does."""
    if own("torque_per_ampere_nm_a") <= 0.0:
        friction = own("friction_currents_a") or model.no_load_current
        return TorqueModel(model.torque_per_ampere, friction, own("tension_stddev_share"))
    return TorqueModel(
        own("torque_per_ampere_nm_a"),
        own("friction_currents_a"),
        own("tension_stddev_share"),
        "calibrated",
        own("friction_slopes_a_s_m"),
        own("gear_load_shares"),
    )


def _winding(own: Callable[[str], Any]) -> Winding | None:
    """Return the resistance and back-EMF that were measured, or None."""
    resistance, back_emf = own("winding_resistances_ohm"), own("back_emfs_v_s")
    if (resistance > 0.0) != (back_emf > 0.0):
        raise ConfigurationError(
            "parameters winding_resistances_ohm, back_emfs_v_s: expected both of a calibration, or 0 for both, found "
            f"{resistance:g} ohm and {back_emf:g} V s/rad"
        )
    return Winding(resistance, back_emf, own("winding_stddev_share")) if resistance > 0.0 else None


def _per_tendon(values: Mapping[str, Any], name: str, tendons: Sequence[str]) -> list[Any]:
    found = list(values[name])
    if len(found) == 1:
        return found * len(tendons)
    if len(found) != len(tendons):
        raise ConfigurationError(
            f"parameter {name}: expected one value, or one for each of {list(tendons)}, found {len(found)}: {found}"
        )
    return found
