# SPDX-License-Identifier: Apache-2.0
"""The backend `damiao`: from the node's parameters to checked motors behind an adapter."""

from __future__ import annotations

from dataclasses import dataclass

from softgrip_driver.damiao.backend import DamiaoBackend, DamiaoMotor, check_ids
from softgrip_driver.damiao.bus import DamiaoBus
from softgrip_driver.damiao.frames import MODELS, POWER_ON_RAD
from softgrip_driver.drives import DriveRequest, Report
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.needs import check_motor
from softgrip_driver.tendon.units import TorqueModel
from softgrip_time import Clock


@dataclass(frozen=True)
class DamiaoDrives:
    """Motors behind one adapter (DriveSet).

    Attributes:
        port, baud, reply_margin: of the adapter.
        motors: one for each tendon, all of one model.
        timeout: [s] of silence after which a motor lets go; 0 = off.
    """

    port: str
    baud: int
    reply_margin: float
    motors: tuple[DamiaoMotor, ...]
    timeout: float

    def backend(self, report: Report, clock: Clock) -> TendonBackend:
        """Return the backend, not connected."""
        bus = DamiaoBus(self.port, self.baud, self.reply_margin, self.motors[0].model.ranges, clock)
        return DamiaoBackend(bus, self.motors, self.timeout, report)


def configure(request: DriveRequest) -> DamiaoDrives:
    """Return the motors that the parameters describe; raises ConfigurationError for values that do not fit."""
    values, ids = request.values, request.device_ids()
    check_ids(ids)
    motors = tuple(_motor(request, tendon, one) for tendon, one in zip(request.tendons, ids, strict=True))
    if len({motor.model.ranges for motor in motors}) > 1:
        raise ConfigurationError("parameter servo_models: expected motors whose feedback has one range, found several")
    # A motor that has lost its master lets go; where a hold is to outlive this process it must not.
    timeout = 0.0 if request.keeps_hold else values["bus_watchdog_s"]
    return DamiaoDrives(values["port"], values["baud"], values["reply_margin_s"], motors, timeout)


def _motor(request: DriveRequest, tendon: str, motor_id: int) -> DamiaoMotor:
    model, spool, limits = request.model(tendon, MODELS), request.spools[tendon], request.limits[tendon]
    check_motor(model, spool, limits, request.values["loop_rate"])
    reach = POWER_ON_RAD + (limits.travel + limits.homing_travel + limits.slack_travel) / spool.radius
    if reach > model.ranges.position:
        raise ConfigurationError(
            f"parameters travel_m, homing_travel_m, slack_travel_m: expected a shaft within {model.ranges.position:g} "
            f"rad of a {model.name}'s origin, found {reach:.1f}; its feedback ends there: take a larger spool"
        )
    torque = request.calibrated_torque(tendon) or TorqueModel(
        model.torque_per_ampere, model.friction_torque / model.torque_per_ampere
    )
    return DamiaoMotor(tendon, motor_id, model, spool, torque, limits.speed, limits.tension_hard)
