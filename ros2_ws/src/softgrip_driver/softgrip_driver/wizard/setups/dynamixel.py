# SPDX-License-Identifier: Apache-2.0
"""Dynamixel servos from their boxes to a chain (DriveSetup)."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag

from softgrip_driver.commands.setup import assign
from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.backend import FAST_BLOCK, DynamixelBackend
from softgrip_driver.dynamixel.bringup import (
    FACTORY_BAUD,
    SHARED_ID_REMEDY,
    SUPPLY_REMEDY,
    ServoConfiguration,
    identify,
    who_answers,
)
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.drive_set import required_parameters
from softgrip_driver.dynamixel.registers import (
    BAUD_CODES,
    MODEL_NAMES,
    MODELS,
    HardwareError,
    OperatingMode,
    ServoModel,
)
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError, DriverError, PortLostError
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.usb_adapter import latency_timer
from softgrip_driver.wizard.drive_setup import BusMeasurement, ChainRow, FoundServo, ServoHealth, SetupModel
from softgrip_time import Clock

#: [s] after which a servo that hears nothing stops: somebody stands beside, pulls are small
WATCHDOG_S = 0.6
#: bytes of a fast group read's instruction, of its answer without what the servos say, and of a read of one servo
GROUP_BYTES, ANSWER_BYTES, SLOW_BYTES = 14, 8, 14 + 18
#: of one servo in the answer: error, ID, data, checksum
SERVO_BYTES = 4 + FAST_BLOCK[1]
BITS_PER_BYTE = 10


class DynamixelSetup:
    """See `DriveSetup`."""

    name = "dynamixel"
    #: a new servo is there, or at the baud rate that this project uses; others are looked at last
    bauds: Sequence[int] = sorted(BAUD_CODES, key=lambda baud: (baud != FACTORY_BAUD, baud != 1_000_000))
    factory = (1, FACTORY_BAUD)
    models: Mapping[str, ServoModel] = MODELS
    model_names = MODEL_NAMES
    supply_remedy = SUPPLY_REMEDY
    shared_id_remedy = SHARED_ID_REMEDY

    def make_bus(self, port: str, baud: int, reply_margin_s: float, clock: Clock | None) -> Bus:
        """See `DriveSetup`."""
        return Bus(port, baud, reply_margin_s, clock)

    def find(self, bus: Bus, wait_s: float) -> Sequence[FoundServo]:
        """See `DriveSetup`."""
        found = []
        for servo_id, (number, firmware) in sorted(bus.broadcast_ping(wait_s).items()):
            try:
                error: HardwareError | None = HardwareError(bus.read(servo_id, reg.HARDWARE_ERROR, attempts=3))
            except PortLostError:
                raise
            except DriverError:
                error = None
            port, name = bus.port, MODEL_NAMES.get(number, "unknown")
            found.append(
                FoundServo(
                    port.port_name, port.baudrate, servo_id, number, name, str(firmware), error, bus.is_shared(servo_id)
                )
            )
        return found

    def model_number(self, bus: Bus, servo_id: int) -> int:
        """See `DriveSetup`."""
        return bus.ping(servo_id, attempts=3)[0]

    def is_shared(self, bus: Bus, servo_id: int) -> bool:
        """See `DriveSetup`."""
        return bus.is_shared(servo_id)

    def assign(self, bus: Bus, servo_id: int, new_id: int | None, new_baud: int | None) -> Sequence[str]:
        """See `DriveSetup`."""
        return assign(bus, servo_id, new_id, new_baud)

    def health(self, bus: Bus, servo_id: int) -> ServoHealth:
        """See `DriveSetup`."""
        return ServoHealth(
            bus.read(servo_id, reg.PRESENT_VOLTAGE, attempts=3) * reg.VOLT_PER_UNIT,
            float(bus.read(servo_id, reg.PRESENT_TEMPERATURE, attempts=3)),
            HardwareError(bus.read(servo_id, reg.HARDWARE_ERROR, attempts=3)),
        )

    def error_causes(self, error: IntFlag, model: SetupModel) -> Sequence[str]:
        """See `DriveSetup`."""
        low, high = model.voltage_range
        causes = {
            HardwareError.INPUT_VOLTAGE: f"its supply is or was not {low:g} to {high:g} V: use one that is",
            HardwareError.OVERHEATING: "let it cool down",
            HardwareError.OVERLOAD: "free its tendon",
        }
        return [text for bit, text in causes.items() if bit in error]

    def reset_remedy(self, port: str, baud: int, servo_id: int) -> str:
        """See `DriveSetup`."""
        return f"`ros2 run softgrip_driver setup --port {port} --baud {baud} --id {servo_id} --reboot`"

    def turnaround(self, bus: Bus, servo_id: int) -> float:
        """See `DriveSetup`."""
        return bus.turnaround(servo_id)

    def who_answers(self, bus: Bus) -> str:
        """See `DriveSetup`."""
        return who_answers(bus)

    def torque_of_data_sheet(self, model: ServoModel, spool: Spool) -> TorqueModel:
        """See `DriveSetup`."""
        del spool  # friction that grows with speed is not known
        return TorqueModel(model.torque_per_ampere, model.no_load_current)

    def required_parameters(self, servos: Sequence[tuple[ServoModel, float]]) -> dict[str, float | int]:
        """See `DriveSetup`."""
        return required_parameters(servos)

    def make_backend(
        self, bus: Bus, rows: Sequence[ChainRow], parameters: Mapping[str, float | int], report: Callable[[str], object]
    ) -> DynamixelBackend:
        """See `DriveSetup`."""
        mode = OperatingMode(int(parameters.get("operating_mode", OperatingMode.CURRENT_BASED_POSITION)))
        servos = [
            ServoConfiguration(
                row.tendon,
                row.servo_id,
                row.model,
                row.spool,
                self.torque_of_data_sheet(row.model, row.spool),
                mode,
                row.limits.tension_hard,
                row.limits.speed,
            )
            for row in rows
        ]
        return DynamixelBackend(bus, servos, WATCHDOG_S, report=report)

    def measure(self, bus: Bus, seconds: float) -> BusMeasurement:
        """See `DriveSetup`."""
        return measure(bus, seconds)


def make_setup() -> DynamixelSetup:
    """Return the set-up."""
    return DynamixelSetup()


def measure(bus: Bus, seconds: float) -> BusMeasurement:
    """Run the driver's cycles as fast as can be, at the pace that it keeps with this adapter; no orders are sent.

    Raises:
        DeviceNotFoundError: nobody answers.
        ConfigurationError: a servo of a model that the driver does not know.
    """
    found = bus.broadcast_ping(0.5)
    ids = sorted(found)
    if not ids:
        raise DeviceNotFoundError(
            f"{bus.port.port_name}: expected servos at {bus.port.baudrate} baud, found none; run scan"
        )
    turnaround = bus.turnaround(ids[0])
    bus.allow_lateness(turnaround)
    servos = [identify(bus, _servo(servo_id, number)).servo for servo_id, (number, _) in sorted(found.items())]
    delays = {i: bus.read(i, reg.RETURN_DELAY, attempts=3) * reg.RETURN_DELAY_SECONDS_PER_UNIT for i in ids}
    backend = DynamixelBackend(bus, servos, watchdog=0.0)
    backend.fast = all(servo.fast_sync_read for servo in servos)
    backend.allow_for_adapter()
    lost, corrupt = bus.counters.lost, bus.counters.corrupt
    durations: list[float] = []
    began = bus.clock.now_s()
    while bus.clock.now_s() - began < seconds:
        start = bus.clock.now_s()
        backend.read()
        durations.append(bus.clock.now_s() - start)
    ordered = sorted(durations)
    return BusMeasurement(
        len(ids), bus.port.baudrate, 1.0 / statistics.fmean(durations), statistics.median(durations),
        ordered[int(0.99 * (len(ordered) - 1))], turnaround,
        (bus.counters.lost - lost) / (len(durations) * len(ids)), bus.counters.corrupt - corrupt, delays,
        latency_timer(bus.port.port_name), _wire_time(len(ids), bus.port.baudrate),
    )  # fmt: skip


def _servo(servo_id: int, number: int) -> ServoConfiguration:
    """Return a configuration that is good for reading."""
    model = next((model for model in reg.MODELS.values() if model.number == number), None)
    if model is None:
        raise ConfigurationError(
            f"ID {servo_id}: expected a model of {sorted(reg.MODELS)}, found "
            f"{reg.MODEL_NAMES.get(number, 'an unknown one')} ({number})"
        )
    torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
    return ServoConfiguration(f"ID {servo_id}", servo_id, model, Spool(0.01, 1), torque)


def _wire_time(servos: int, baud: int) -> float:
    """Return the time [s] that the bytes of a cycle alone need."""
    group = GROUP_BYTES + ANSWER_BYTES + servos * (1 + SERVO_BYTES)
    return (group + SLOW_BYTES) * BITS_PER_BYTE / baud
