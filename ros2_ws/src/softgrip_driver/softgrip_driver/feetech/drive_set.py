# SPDX-License-Identifier: Apache-2.0
"""The backend `feetech`: from the node's parameters to checked servos on a bus."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softgrip_driver.drives import DriveRequest, Report
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.feetech import registers as reg
from softgrip_driver.feetech.backend import FeetechBackend
from softgrip_driver.feetech.bus import FeetechBus
from softgrip_driver.feetech.registers import BAUD_CODES, MODELS, FeetechModel
from softgrip_driver.feetech.servo import FeetechServo
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.needs import check_motor
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.tendon.winding import Winding
from softgrip_time import Clock

#: [rad/s] of the speed that it reports: full counts of 0.732 rpm, whatever the unit is
SPEED_STDDEV = reg.RAD_PER_S_COARSE / math.sqrt(12.0)
#: torque constant and friction of one servo beside the data sheet's: its makers and sellers differ by a tenth and more
TORQUE_STDDEV_SHARE = 0.2


@dataclass(frozen=True)
class FeetechDrives:
    """Servos on one bus (DriveSet).

    Attributes:
        port, baud, reply_margin: of the bus.
        servos: one for each tendon.
        write_eeprom: correct persistent settings.
    """

    port: str
    baud: int
    reply_margin: float
    servos: tuple[FeetechServo, ...]
    write_eeprom: bool

    def backend(self, report: Report, clock: Clock) -> TendonBackend:
        """Return the backend, not connected."""
        bus = FeetechBus(self.port, self.baud, self.reply_margin, clock)
        return FeetechBackend(bus, self.servos, write_eeprom=self.write_eeprom, report=report)


def configure(request: DriveRequest) -> FeetechDrives:
    """Return the servos that the parameters describe; raises ConfigurationError for values that do not fit."""
    values = request.values
    if values["baud"] not in BAUD_CODES:
        raise ConfigurationError(
            f"parameter baud: expected one of {list(BAUD_CODES)} with backend 'feetech', found {values['baud']}"
        )
    return FeetechDrives(
        values["port"],
        values["baud"],
        values["reply_margin_s"],
        tuple(
            _servo(request, tendon, device_id)
            for tendon, device_id in zip(request.tendons, request.device_ids(), strict=True)
        ),
        values["write_eeprom"],
    )


def _servo(request: DriveRequest, tendon: str, servo_id: int) -> FeetechServo:
    model, spool, limits = request.model(tendon, MODELS), request.spools[tendon], request.limits[tendon]
    check_motor(model, spool, limits, request.values["loop_rate"])
    torque = request.calibrated_torque(tendon) or torque_of(model, spool)
    return FeetechServo(tendon, servo_id, model, spool, torque, winding_of(model), limits.tension_hard, limits.speed)


def torque_of(model: FeetechModel, spool: Spool) -> TorqueModel:
    """Return the torque model of a data sheet; the no-load current is friction, a share of it grows with speed."""
    viscous = (1.0 - model.coulomb_share) * model.no_load_current
    return TorqueModel(
        model.torque_per_ampere,
        model.coulomb_share * model.no_load_current,
        TORQUE_STDDEV_SHARE,
        friction_slope=viscous / (model.no_load_speed * spool.radius),
    )


def winding_of(model: FeetechModel) -> Winding:
    """Return the winding of a data sheet."""
    return Winding(model.resistance, model.back_emf, speed_stddev=SPEED_STDDEV)
