# SPDX-License-Identifier: Apache-2.0
"""From a table of plain values (the node's parameters, or a command's options) to checked settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import Servo
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import BAUD_CODES, MODELS, OperatingMode
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.gripper import GripperController, Policies, StopPolicy
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import Spool, TorqueModel

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
    "lead": "lead_m",
    "position_tolerance": "position_tolerance_m",
    "tension_tolerance": "tension_tolerance",
    "temperature_limit": "temperature_limit_degc",
    "no_reply": "no_reply_s",
    "homing_tension": "homing_tension_n",
    "homing_speed": "homing_speed_m_s",
    "homing_travel": "homing_travel_m",
    "homing_timeout": "homing_timeout_s",
}


@dataclass(frozen=True)
class DriverConfiguration:
    """Everything the tendon driver needs to know.

    Attributes:
        port, baud, reply_margin: of the bus.
        servos: one for each tendon.
        limits: by tendon.
        grippers: by tendon, the gripper it belongs to.
        policies: of the whole gripper.
        loop_rate: [Hz]
        bus_watchdog: [s]
        write_eeprom: correct persistent settings.
        zero_file: None keeps no zeros.
    """

    port: str
    baud: int
    reply_margin: float
    servos: tuple[Servo, ...]
    limits: Mapping[str, TendonLimits]
    grippers: Mapping[str, str]
    policies: Policies
    loop_rate: float
    bus_watchdog: float
    write_eeprom: bool
    zero_file: Path | None

    def controller(self) -> GripperController:
        """Return the controller, knowing nothing yet."""
        return GripperController(self.limits, self.policies, self.grippers)

    def backend(self) -> DynamixelBackend:
        """Return the backend, not connected."""
        bus = Bus(self.port, self.baud, self.reply_margin)
        return DynamixelBackend(bus, self.servos, self.bus_watchdog, write_eeprom=self.write_eeprom)


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
    ids = _per_tendon(values, "servo_ids", tendons)
    if len(set(ids)) != len(ids):
        raise ConfigurationError(f"parameter servo_ids: expected each ID once, found {ids}")
    limits = _limits(values)
    return DriverConfiguration(
        port=values["port"],
        baud=values["baud"],
        reply_margin=values["reply_margin_s"],
        servos=tuple(_servo(values, tendons, index, limits) for index in range(len(tendons))),
        limits=dict.fromkeys(tendons, limits),
        grippers=dict(zip(tendons, _per_tendon(values, "grippers", tendons), strict=True)),
        policies=Policies(
            estop=StopPolicy[values["estop_policy"].upper()],
            command_timeout=values["command_timeout_s"],
            release_after=values["release_after_s"],
            continuous_tension=values["continuous_tension_n"],
        ),
        loop_rate=values["loop_rate"],
        bus_watchdog=values["bus_watchdog_s"],
        write_eeprom=values["write_eeprom"],
        zero_file=Path(values["zero_file"]).expanduser() if values["zero_file"] else None,
    )


def _limits(values: Mapping[str, Any]) -> TendonLimits:
    return TendonLimits(**{field.name: values[LIMIT_PARAMETERS[field.name]] for field in fields(TendonLimits)})


def _servo(values: Mapping[str, Any], tendons: Sequence[str], index: int, limits: TendonLimits) -> Servo:
    def own(name: str) -> Any:
        return _per_tendon(values, name, tendons)[index]

    name = own("servo_models")
    if name not in MODELS:
        raise ConfigurationError(f"parameter servo_models: expected names out of {sorted(MODELS)}, found '{name}'")
    model = MODELS[name]
    calibrated = own("torque_per_ampere_nm_a") > 0.0
    torque = TorqueModel(
        own("torque_per_ampere_nm_a") if calibrated else model.torque_per_ampere,
        own("friction_currents_a") if calibrated else model.no_load_current,
        own("tension_stddev_share"),
        "calibrated" if calibrated else "data sheet",
    )
    return Servo(
        tendons[index],
        own("servo_ids"),
        model,
        Spool(own("spool_radii_m"), own("directions")),
        torque,
        OperatingMode(values["operating_mode"]),
        limits.tension_hard,
        limits.speed,
    )


def _per_tendon(values: Mapping[str, Any], name: str, tendons: Sequence[str]) -> list[Any]:
    found = list(values[name])
    if len(found) == 1:
        return found * len(tendons)
    if len(found) != len(tendons):
        raise ConfigurationError(
            f"parameter {name}: expected one value, or one for each of {list(tendons)}, found {len(found)}: {found}"
        )
    return found
