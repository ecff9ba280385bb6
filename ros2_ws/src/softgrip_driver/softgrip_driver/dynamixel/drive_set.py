# SPDX-License-Identifier: Apache-2.0
"""The backend `dynamixel`: from the node's parameters to checked servos on a bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from softgrip_driver.drives import DriveRequest, Report
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import BAUD_CODES, MODELS, CurrentSensing, OperatingMode, ServoModel
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.needs import check_motor, required_limits
from softgrip_driver.tendon.rest import WATCHDOG_PERIODS
from softgrip_driver.tendon.units import TorqueModel
from softgrip_driver.tendon.winding import Winding
from softgrip_time import Clock


@dataclass(frozen=True)
class DynamixelDrives:
    """Servos on one bus (DriveSet).

    Attributes:
        port, baud, reply_margin: of the bus.
        servos: one for each tendon.
        bus_watchdog: [s]
        write_eeprom: correct persistent settings.
        hold_unwatched: a hold outlives this process.
    """

    port: str
    baud: int
    reply_margin: float
    servos: tuple[ServoConfiguration, ...]
    bus_watchdog: float
    write_eeprom: bool
    hold_unwatched: bool

    def backend(self, report: Report, clock: Clock) -> TendonBackend:
        """Return the backend, not connected."""
        return DynamixelBackend(
            Bus(self.port, self.baud, self.reply_margin, clock),
            self.servos,
            self.bus_watchdog,
            write_eeprom=self.write_eeprom,
            report=report,
            hold_unwatched=self.hold_unwatched,
        )


def configure(request: DriveRequest) -> DynamixelDrives:
    """Return the servos that the parameters describe; raises ConfigurationError for values that do not fit."""
    values = request.values
    if values["baud"] not in BAUD_CODES:
        raise ConfigurationError(f"parameter baud: expected one of {list(BAUD_CODES)}, found {values['baud']}")
    if 0.0 < values["bus_watchdog_s"] < WATCHDOG_PERIODS / values["loop_rate"]:
        raise ConfigurationError(
            f"parameter bus_watchdog_s: expected 0, or at least {WATCHDOG_PERIODS:g} periods of the loop of "
            f"{values['loop_rate']:g} Hz, found {values['bus_watchdog_s']:g}; servos would stop between two orders"
        )
    return DynamixelDrives(
        port=values["port"],
        baud=values["baud"],
        reply_margin=values["reply_margin_s"],
        servos=tuple(
            _servo(request, tendon, device_id)
            for tendon, device_id in zip(request.tendons, request.device_ids(), strict=True)
        ),
        bus_watchdog=values["bus_watchdog_s"],
        write_eeprom=values["write_eeprom"],
        hold_unwatched=request.keeps_hold,
    )


def _servo(request: DriveRequest, tendon: str, servo_id: int) -> ServoConfiguration:
    def own(name: str) -> Any:
        return request.own(name, tendon)

    spool, limits = request.spools[tendon], request.limits[tendon]
    model = request.model(tendon, MODELS)
    check_motor(model, spool, limits, request.values["loop_rate"])
    mode = OperatingMode(request.values["operating_mode"])
    if model.senses is CurrentSensing.NONE and mode is OperatingMode.CURRENT_BASED_POSITION:
        raise ConfigurationError(
            f"parameter operating_mode: expected 4 with a {model.name}, which knows no current, found "
            f"{mode.value}; there its Goal PWM limits the tension"
        )
    return ServoConfiguration(
        tendon,
        servo_id,
        model,
        spool,
        request.calibrated_torque(tendon) or _torque_of_data_sheet(own, model),
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
    found = required_limits(servos)
    if any(model.senses is CurrentSensing.NONE for model, _ in servos):
        found["operating_mode"] = OperatingMode.EXTENDED_POSITION.value
    return found


def _torque_of_data_sheet(own: Callable[[str], Any], model: ServoModel) -> TorqueModel:
    friction = own("friction_currents_a") or model.no_load_current
    return TorqueModel(model.torque_per_ampere, friction, own("tension_stddev_share"))


def _winding(own: Callable[[str], Any]) -> Winding | None:
    """Return the resistance and back-EMF that were measured, or None."""
    resistance, back_emf = own("winding_resistances_ohm"), own("back_emfs_v_s")
    if (resistance > 0.0) != (back_emf > 0.0):
        raise ConfigurationError(
            "parameters winding_resistances_ohm, back_emfs_v_s: expected both of a calibration, or 0 for both, found "
            f"{resistance:g} ohm and {back_emf:g} V s/rad"
        )
    return Winding(resistance, back_emf, own("winding_stddev_share")) if resistance > 0.0 else None
