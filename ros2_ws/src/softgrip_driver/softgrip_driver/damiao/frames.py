# SPDX-License-Identifier: Apache-2.0
"""Frames of Damiao's motors: bytes in, values out.

Sources: Damiao, "DM-J4310-2EC user manual" as its own DM_CAN.py and damiao-motor 1.0.6 carry it out. Each order is
answered with a feedback frame; registers are asked and written through ID 0x7FF.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from softgrip_driver.damiao.slcan import Frame
from softgrip_driver.tendon.needs import TendonNeeds

REGISTER_ID = 0x7FF
_READ, _WRITE, _REFRESH = 0x33, 0x55, 0xCC
_ENABLE, _DISABLE, _CLEAR = 0xFC, 0xFD, 0xFB
#: position and force together: a position, the largest speed, the largest current
FORCE_POSITION_OFFSET, FORCE_POSITION_MODE = 0x300, 4
_SPEED_PER_UNIT, _MAX_SPEED = 0.01, 100.0
CURRENT_UNITS = 10_000
TIMEOUT_S_PER_UNIT = 50e-6
#: bits of the feedback's position, speed and torque
_POSITION_BITS, _SPEED_BITS, _TORQUE_BITS = 16, 12, 12
#: the feedback carries four bits of the ID
MAX_ID = 15


class Register(IntEnum):
    """Registers that matter here."""

    OVER_TEMPERATURE = 2
    TIMEOUT = 9
    CONTROL_MODE = 10
    SOFTWARE_VERSION = 14
    GEAR_RATIO = 20
    POSITION_RANGE = 21
    SPEED_RANGE = 22
    TORQUE_RANGE = 23
    MAX_CURRENT = 59
    SUPPLY_VOLTAGE = 60


_WHOLE = frozenset({Register.TIMEOUT, Register.CONTROL_MODE, Register.SOFTWARE_VERSION})


class DamiaoState(IntEnum):
    """High four bits of a feedback's first byte."""

    DISABLED = 0x0
    ENABLED = 0x1
    OVER_VOLTAGE = 0x8
    UNDER_VOLTAGE = 0x9
    OVER_CURRENT = 0xA
    BOARD_TOO_WARM = 0xB
    ROTOR_TOO_WARM = 0xC
    LOST_COMMUNICATION = 0xD
    OVERLOAD = 0xE


@dataclass(frozen=True)
class Ranges:
    """What the feedback's integers map to, + and - [rad], [rad/s], [N m] (registers 21 to 23)."""

    position: float
    speed: float
    torque: float

    @property
    def torque_step(self) -> float:
        """One count of the torque [N m]."""
        return 2.0 * self.torque / ((1 << _TORQUE_BITS) - 1)


@dataclass(frozen=True)
class Feedback:
    """What a motor answers to an order.

    Attributes:
        state: of DamiaoState, or a number that no document names.
        position, speed, torque: [rad], [rad/s], [N m] at the output.
        board, rotor: [degC]
    """

    motor_id: int
    state: int
    position: float
    speed: float
    torque: float
    board: float
    rotor: float


def enable(motor_id: int) -> Frame:
    """Return the order to hold."""
    return Frame(motor_id, b"\xff" * 7 + bytes([_ENABLE]))


def disable(motor_id: int) -> Frame:
    """Return the order to let go."""
    return Frame(motor_id, b"\xff" * 7 + bytes([_DISABLE]))


def clear_error(motor_id: int) -> Frame:
    """Return the order to forget an error."""
    return Frame(motor_id, b"\xff" * 7 + bytes([_CLEAR]))


def refresh(motor_id: int) -> Frame:
    """Return the question for a feedback; nothing moves."""
    return Frame(REGISTER_ID, struct.pack("<HB5x", motor_id, _REFRESH))


def force_position(motor_id: int, position: float, speed: float, current_share: float) -> Frame:
    """Return the order to go to a position [rad] with at most a speed [rad/s] and a share of the largest current."""
    speed_units = round(max(0.0, min(_MAX_SPEED, speed)) / _SPEED_PER_UNIT)
    current_units = round(CURRENT_UNITS * max(0.0, min(1.0, current_share)))
    return Frame(FORCE_POSITION_OFFSET + motor_id, struct.pack("<fHH", position, speed_units, current_units))


def addressee(order: Frame) -> int:
    """Return the ID of the motor that an order or a question is for."""
    return int.from_bytes(order.data[:2], "little") if order.can_id == REGISTER_ID else order.can_id & 0xFF


def read_register(motor_id: int, register: Register) -> Frame:
    """Return the question for a register."""
    return Frame(REGISTER_ID, struct.pack("<HBB4x", motor_id, _READ, register))


def write_register(motor_id: int, register: Register, value: float) -> Frame:
    """Return the order to set a register until the power goes."""
    packed = struct.pack("<I", round(value)) if register in _WHOLE else struct.pack("<f", value)
    return Frame(REGISTER_ID, struct.pack("<HBB", motor_id, _WRITE, register) + packed)


def register_value(frame: Frame, motor_id: int, register: Register) -> float | None:
    """Return the value that a frame says a motor's register has, None where it says something else."""
    if len(frame.data) != 8 or frame.data[:2] != struct.pack("<H", motor_id):
        return None
    if frame.data[2] not in (_READ, _WRITE) or frame.data[3] != register:
        return None
    (value,) = struct.unpack("<I" if register in _WHOLE else "<f", frame.data[4:8])
    return float(value)


def feedback(frame: Frame, ranges: Ranges) -> Feedback | None:
    """Return what a feedback frame says, None for any other frame."""
    if len(frame.data) != 8 or frame.can_id >= REGISTER_ID or (frame.data[2] in (_READ, _WRITE) and frame.data[1] == 0):
        return None
    first, *_ = frame.data
    position, speed_torque, torque_low, board, rotor = struct.unpack(">HHBBB", frame.data[1:])
    speed, torque = speed_torque >> 4, (speed_torque & 0xF) << 8 | torque_low
    return Feedback(
        first & 0xF, first >> 4, _scaled(position, ranges.position, _POSITION_BITS),
        _scaled(speed, ranges.speed, _SPEED_BITS), _scaled(torque, ranges.torque, _TORQUE_BITS), board, rotor,
    )  # fmt: skip


def _scaled(value: int, limit: float, bits: int) -> float:
    return 2.0 * limit * value / ((1 << bits) - 1) - limit


@dataclass(frozen=True, kw_only=True)
class DamiaoModel:
    """What differs between models.

    Attributes:
        ranges: factory values of the registers 21 to 23.
        gear_ratio: of register 20, which tells whether it is this model.
        stall_torque: [N m] peak torque. torque_per_ampere: [N m/A] at the output.
        friction_torque: [N m] of the gears.
        temperature_limit: [degC] of the rotor.
        needs: limits of a tendon on it, proven in the emulator (test_other_drives.py).
    """

    name: str
    ranges: Ranges
    gear_ratio: float
    stall_torque: float
    torque_per_ampere: float
    friction_torque: float
    temperature_limit: float
    needs: TendonNeeds


#: models a tendon may hang on, by name. Seeed Studio wiki, "Damiao 43 series", table of specifications; ranges also
#: damiao-motor 1.0.6. No document gives the friction of the gears: it is assumed. Each goal gives its stiff position
#: loop a jerk, and its torque is read just before the next one: from 3.5 rad/s on a taut tendon then reads as slack
MODELS: dict[str, DamiaoModel] = {
    model.name: model
    for model in (
        DamiaoModel(
            name="DM-J4310-2EC", ranges=Ranges(12.5, 30.0, 10.0), gear_ratio=10.0, stall_torque=7.0,
            torque_per_ampere=0.945, friction_torque=0.06, temperature_limit=100.0, needs=TendonNeeds(0.08, 2.0, 20.0),
        ),
    )
}  # fmt: skip
#: [rad] either way that the output may stand from its origin when the power comes on: it knows one turn
POWER_ON_RAD = math.pi
