# SPDX-License-Identifier: Apache-2.0
"""Servos of every family: what the plant needs of one, and which chain carries it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from softgrip_emulator.damiao import motor as damiao_motor
from softgrip_emulator.damiao.adapter import SlcanAdapter
from softgrip_emulator.damiao.motor import EmulatedDamiaoMotor
from softgrip_emulator.dynamixel import table as dynamixel_table
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import FACTORY_BAUD, FACTORY_ID, EmulatedServo
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.feetech import memory as feetech_memory
from softgrip_emulator.feetech.chain import FeetechChain
from softgrip_emulator.feetech.servo import EmulatedFeetechServo

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Sequence

    from softgrip_emulator.dynamixel.motion import ServoDrive
    from softgrip_emulator.dynamixel.servo import Shaft
    from softgrip_emulator.dynamixel.table import MotorRatings


_FAMILIES = (dynamixel_table, feetech_memory, damiao_motor)


class MotorModel(Protocol):
    """What the plant needs of a model."""

    @property
    def motor(self) -> MotorRatings:
        """Motor and gear."""


class PlantServo(Protocol):
    """What the plant and its faults need of a servo."""

    shaft: Shaft
    registers: Any
    silenced: bool
    is_connected: bool
    forced_error_bits: int
    position_glitch_pulses: int

    @property
    def model(self) -> MotorModel:
        """Its model."""

    @property
    def device_id(self) -> int:
        """ID on the bus."""

    @property
    def powered(self) -> bool:
        """Whether its processor lives."""

    @property
    def holds(self) -> bool:
        """Whether its torque is on."""

    def lose_power(self, now_s: float) -> None:
        """Reboot, or begin without power."""

    def step(self, now_s: float, dt_s: float) -> ServoDrive:
        """One step of the firmware."""


def available_models() -> list[str]:
    """File names of all models that are described."""
    return sorted(name for family in _FAMILIES for name in family.available_models())


def load_ratings(model: str) -> MotorRatings:
    """Motor and gear of a model by name; raises EmulatorError where there is none."""
    ratings: MotorRatings = _model(model).motor
    return ratings


def factory_settings(model: str) -> tuple[int, int]:
    """ID and speed [bit/s] of a model as it comes.

    Raises:
        EmulatorError: no such model, or one that has no ID on a serial bus.
    """
    described = _model(model)
    if isinstance(described, feetech_memory.EmulatedFeetechModel):
        values = {item.name: item.initial for item in described.items}
        return values["id"], feetech_memory.BAUD_OF_REGISTER[values["baud_rate"]]
    if isinstance(described, damiao_motor.EmulatedDamiaoModel):
        raise EmulatorError(
            f"factory_fresh: expected servos that get their IDs over the bus, found {model}; its maker's tool sets it"
        )
    return FACTORY_ID, FACTORY_BAUD


def _model(name: str) -> Any:
    stem = name.lower().replace("-", "_")
    for family in _FAMILIES:
        if stem in family.available_models():
            return family.load_model(name)
    raise EmulatorError(f"servo model: expected one of {available_models()}, found '{name}'")


def make_servo(
    model: str,
    device_id: int,
    *,
    baud: int,
    return_delay_us: int,
    limits_winding: bool = False,
    trips_early: bool = False,
) -> PlantServo:
    """A servo as it comes, by the name of its model; what it limits and when it trips: see `EmulatedServo`.

    Raises:
        EmulatorError: no such model.
    """
    described = _model(model)
    if isinstance(described, feetech_memory.EmulatedFeetechModel):
        return EmulatedFeetechServo(described, device_id, baud=baud, return_delay_us=return_delay_us)
    if isinstance(described, damiao_motor.EmulatedDamiaoModel):
        return EmulatedDamiaoMotor(described, device_id)
    return EmulatedServo(
        described,
        device_id,
        baud=baud,
        return_delay_us=return_delay_us,
        limits_winding=limits_winding,
        trips_early=trips_early,
    )


def make_chain(
    servos: Sequence[PlantServo], lock: threading.RLock, before: Callable[[float], None]
) -> DynamixelChain | FeetechChain | SlcanAdapter:
    """The bus of servos that are all of one family.

    Raises:
        EmulatorError: they speak different protocols.
    """
    if all(isinstance(servo, EmulatedServo) for servo in servos):
        return DynamixelChain([one for one in servos if isinstance(one, EmulatedServo)], lock=lock, before=before)
    if all(isinstance(servo, EmulatedFeetechServo) for servo in servos):
        return FeetechChain([one for one in servos if isinstance(one, EmulatedFeetechServo)], lock=lock, before=before)
    if all(isinstance(servo, EmulatedDamiaoMotor) for servo in servos):
        return SlcanAdapter([one for one in servos if isinstance(one, EmulatedDamiaoMotor)], lock=lock, before=before)
    raise EmulatorError("servo chain: expected servos of one family, found several; they speak different protocols")
