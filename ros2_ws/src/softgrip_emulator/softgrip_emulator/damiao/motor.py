# SPDX-License-Identifier: Apache-2.0
"""One Damiao motor: registers, orders and control loops (sources: the YAML's head, damiao-motor 1.0.6, DM_CAN.py)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from softgrip_emulator.dynamixel.motion import ServoDrive
from softgrip_emulator.dynamixel.servo import Shaft
from softgrip_emulator.dynamixel.table import MotorRatings
from softgrip_emulator.model_files import described, read_description

_FOLDER: Final = Path(__file__).parent
BOOT_SILENCE_S: Final = 0.4
"""Assumption."""
_MIT, _POSITION_SPEED, _SPEED, _FORCE_POSITION = 1, 2, 3, 4
_OFFSETS: Final = {0x000: _MIT, 0x100: _POSITION_SPEED, 0x200: _SPEED, 0x300: _FORCE_POSITION}
_REGISTER_ID: Final = 0x7FF
_READ, _WRITE, _STORE, _REFRESH = 0x33, 0x55, 0xAA, 0xCC
_ENABLE, _DISABLE, _SET_ZERO, _CLEAR = 0xFC, 0xFD, 0xFE, 0xFB
_TIMEOUT_UNIT_S: Final = 50e-6
_SPEED_BANDWIDTH_RAD_S: Final = 2.0 * math.pi * 50.0
"""Of the speed loop: assumption, since the manual gives no unit of KP_ASR. Its integral acts by the ratio of KI_ASR to
KP_ASR, taken as one of seconds; KI_ASR 0 is a loop without. Its damping and filter, Deta and V_BW, have no unit either.
"""
_MAX_KP, _MAX_KD = 500.0, 5.0


class MotorState:
    """High four bits of a feedback's first byte."""

    DISABLED: Final = 0x0
    ENABLED: Final = 0x1
    OVER_VOLTAGE: Final = 0x8
    UNDER_VOLTAGE: Final = 0x9
    ROTOR_TOO_WARM: Final = 0xC
    LOST_COMMUNICATION: Final = 0xD
    OVERLOAD: Final = 0xE


_STATE_OF_FAULT_BITS: Final = {0x01: MotorState.UNDER_VOLTAGE, 0x20: MotorState.OVERLOAD}
"""The emulator's faults speak in bits of the X series."""


@dataclass(frozen=True, slots=True)
class EmulatedDamiaoModel:
    """A motor model: registers (number -> name, kind, writable, initial value) and motor."""

    name: str
    registers: dict[int, tuple[str, str, bool, float]]
    motor: MotorRatings


def available_models() -> list[str]:
    """File names of the models that are described."""
    return described(_FOLDER)


@cache
def load_model(name: str) -> EmulatedDamiaoModel:
    """Read a model by name ("DM-J4310-2EC").

    Raises:
        EmulatorError: no such model.
    """
    data = read_description(_FOLDER, name)
    registers = {number: tuple(row) for number, row in data["registers"].items()}
    return EmulatedDamiaoModel(data["name"], registers, MotorRatings(**data["motor"]))


class DamiaoRegisters:
    """Values of one motor by number and by name; what is not stored is gone with the power."""

    def __init__(self, model: EmulatedDamiaoModel) -> None:
        self._rows = model.registers
        self._numbers = {row[0]: number for number, row in model.registers.items()}
        self._values = {number: row[3] for number, row in model.registers.items()}
        self._stored = dict(self._values)

    def get(self, name: str) -> float:
        """Value by name; `baud_rate` is the code of the CAN bit rate."""
        return self._values[self._numbers["can_br" if name == "baud_rate" else name]]

    def put(self, name: str, value: float) -> None:
        """Set a value by name."""
        self._values[self._numbers["can_br" if name == "baud_rate" else name]] = value

    def read(self, number: int) -> bytes | None:
        """Four bytes of a register; None where there is none."""
        if number not in self._rows:
            return None
        value = self._values[number]
        return struct.pack("<f", value) if self._rows[number][1] == "float" else struct.pack("<I", int(value))

    def write(self, number: int, data: bytes) -> None:
        """Set a register from four bytes; one that is read-only keeps its value."""
        if number in self._rows and self._rows[number][2]:
            (self._values[number],) = struct.unpack("<f" if self._rows[number][1] == "float" else "<I", data)

    def store(self) -> None:
        """Keep all values without power."""
        self._stored = dict(self._values)

    def lose_power(self) -> None:
        """Go back to what was stored."""
        self._values = dict(self._stored)


class EmulatedDamiaoMotor:
    """Firmware and encoder of one motor; `step` is called by the plant, the rest by the bus, on one lock."""

    def __init__(self, model: EmulatedDamiaoModel, device_id: int) -> None:
        self.model = model
        self.registers = DamiaoRegisters(model)
        self.registers.put("esc_id", device_id)
        self.registers.put("mst_id", 0x10 + device_id)
        self.registers.store()
        self.shaft = Shaft(supply_v=model.motor.nominal_voltage_v)
        self.position_glitch_pulses = 0
        self.forced_error_bits = 0
        self.silenced = False
        self.is_connected = True
        self._silent_until_s = 0.0
        self._ordered_s = 0.0
        self._state = MotorState.DISABLED
        self._order: tuple[float, ...] = ()
        self._origin_rad = 0.0
        self._speed_integral_nm = 0.0
        self.fold()

    # -- on the bus ------------------------------------------------------------------------------------------------

    @property
    def device_id(self) -> int:
        """ID that orders go to."""
        return int(self.registers.get("esc_id"))

    @property
    def holds(self) -> bool:
        """Whether its torque is on."""
        return self._state == MotorState.ENABLED

    @property
    def powered(self) -> bool:
        """Whether it hangs on the cable, and the supply keeps its processor alive."""
        return self.is_connected and self.shaft.supply_v > self.model.motor.brown_out_v

    def listens(self, now_s: float, bit_rate_code: int) -> bool:
        """Whether it hears a frame now."""
        same = self.registers.get("can_br") == bit_rate_code
        return same and not self.silenced and self.powered and now_s >= self._silent_until_s

    def receive(self, can_id: int, data: bytes, now_s: float) -> tuple[int, bytes] | None:
        """Obey a frame of eight bytes; return the ID and the bytes of the answer, None where it is for others."""
        if can_id == _REGISTER_ID:
            return self._register(data)
        offset, own = can_id & 0x700, can_id & 0xFF
        if own != self.device_id or offset not in _OFFSETS:
            return None
        self._ordered_s = now_s
        if data[:7] == b"\xff" * 7 and data[7] >= _CLEAR:
            self._command(data[7])
        elif self.registers.get("ctrl_mode") == _OFFSETS[offset]:
            self._order = self._decoded(_OFFSETS[offset], data)
        return self._feedback()

    def _command(self, code: int) -> None:
        if code == _ENABLE and self._state == MotorState.DISABLED:
            self._state = MotorState.ENABLED
        elif code == _DISABLE and self._state == MotorState.ENABLED:
            self._state, self._order = MotorState.DISABLED, ()
        elif code == _CLEAR:
            self._state, self.forced_error_bits, self._order = MotorState.DISABLED, 0, ()
        elif code == _SET_ZERO:
            self._origin_rad = self.shaft.angle_rad

    def _register(self, data: bytes) -> tuple[int, bytes] | None:
        if int.from_bytes(data[:2], "little") != self.device_id:
            return None
        command, number = data[2], data[3]
        if command == _REFRESH:
            return self._feedback()
        if command == _STORE:
            self.registers.store()
            return self._feedback()
        if command == _WRITE:
            self.registers.write(number, data[4:8])
        elif command != _READ:
            return None
        self.registers.put("vbus", self.shaft.supply_v)
        self.registers.put("xout", self._position())
        value = self.registers.read(number)
        return None if value is None else (int(self.registers.get("mst_id")), data[:4] + value)

    def _decoded(self, mode: int, data: bytes) -> tuple[float, ...]:
        """An order in SI units: position, speed, then what the mode has beside."""
        if mode == _FORCE_POSITION:
            position, speed, current = struct.unpack("<fHH", data)
            return position, speed / 100.0, current / 10_000.0 * self.registers.get("imax")
        if mode == _POSITION_SPEED:
            return tuple(struct.unpack("<ff", data))
        if mode == _SPEED:
            return tuple(struct.unpack("<f4x", data))
        get, bits = self.registers.get, int.from_bytes(data, "big")
        position, speed = (bits >> 48, get("pmax"), 16), (bits >> 36 & 0xFFF, get("vmax"), 12)
        torque = (bits & 0xFFF, get("tmax"), 12)
        stiffness, damping = _MAX_KP * (bits >> 24 & 0xFFF) / 4095, _MAX_KD * (bits >> 12 & 0xFFF) / 4095
        return _spread(*position), _spread(*speed), stiffness, damping, _spread(*torque)

    def _feedback(self) -> tuple[int, bytes]:
        get, shaft = self.registers.get, self.shaft
        torque = shaft.current_a * get("kt_value")
        position = _packed(self._position(), get("pmax"), 16)
        speed, torque_units = _packed(shaft.velocity_rad_s, get("vmax"), 12), _packed(torque, get("tmax"), 12)
        data = struct.pack(
            ">BHHBBB", self._state << 4 | self.device_id & 0xF, position, speed << 4 | torque_units >> 8,
            torque_units & 0xFF, _byte(shaft.temperature_c), _byte(shaft.winding_c),
        )  # fmt: skip
        return int(get("mst_id")), data

    # -- firmware --------------------------------------------------------------------------------------------------

    def lose_power(self, now_s: float) -> None:
        """Reboot or supply failure: what was not stored is gone, turns too, silence while it boots."""
        self._silent_until_s = now_s + BOOT_SILENCE_S
        self._state, self._order, self.forced_error_bits = MotorState.DISABLED, (), 0
        self.registers.lose_power()
        self.fold()

    def fold(self) -> None:
        """Two encoders know the output within one turn: forget the others."""
        self._origin_rad = 2.0 * math.pi * round(self.shaft.angle_rad / (2.0 * math.pi))

    def step(self, now_s: float, dt_s: float) -> ServoDrive:
        """One step of the firmware: protections, then the loops. Returns what the power stage is told."""
        self._watch(now_s)
        if self._state != MotorState.ENABLED or not self._order or now_s < self._silent_until_s or not self.powered:
            self._speed_integral_nm = 0.0
            return ServoDrive()
        limit = self.registers.get("imax")
        if self.registers.get("ctrl_mode") == _FORCE_POSITION:
            limit = min(limit, self._order[2])
        current = self._asked_torque(limit, dt_s) / self.registers.get("kt_value")
        # A current source: as much voltage as it takes, in the direction asked for.
        return ServoDrive(math.copysign(1.0, current), min(abs(current), limit))

    def _asked_torque(self, limit_a: float, dt_s: float) -> float:
        mode, order, speed = self.registers.get("ctrl_mode"), self._order, self.shaft.velocity_rad_s
        if mode == _MIT:
            position, asked, stiffness, damping, torque = order
            return stiffness * (position - self._position()) + damping * (asked - speed) + torque
        if mode == _SPEED:
            asked = order[0]
        else:
            asked = self.registers.get("kp_apr") * (order[0] - self._position())
            asked = max(-order[1], min(order[1], asked))
        return self._speed_loop(asked - speed, limit_a * self.registers.get("kt_value"), dt_s)

    def _speed_loop(self, lack_rad_s: float, limit_nm: float, dt_s: float) -> float:
        """Return the torque that a lack of speed asks for; its integral keeps within what the current allows."""
        get = self.registers.get
        proportional_nm = self.model.motor.inertia_kgm2 * _SPEED_BANDWIDTH_RAD_S * lack_rad_s
        if get("kp_asr") > 0.0:
            summed_nm = self._speed_integral_nm + get("ki_asr") / get("kp_asr") * proportional_nm * dt_s
            self._speed_integral_nm = max(-limit_nm, min(limit_nm, summed_nm))
        return proportional_nm + self._speed_integral_nm

    def _watch(self, now_s: float) -> None:
        get, shaft = self.registers.get, self.shaft
        for bit, state in _STATE_OF_FAULT_BITS.items():
            if self.forced_error_bits & bit:
                self._state = state
        if self.powered and shaft.supply_v < get("uv_value"):
            self._state = MotorState.UNDER_VOLTAGE
        if shaft.supply_v > get("ov_value"):
            self._state = MotorState.OVER_VOLTAGE
        if shaft.winding_c > get("ot_value"):
            self._state = MotorState.ROTOR_TOO_WARM
        timeout_s = get("timeout") * _TIMEOUT_UNIT_S
        if self._state == MotorState.ENABLED and 0.0 < timeout_s < now_s - self._ordered_s:
            self._state = MotorState.LOST_COMMUNICATION

    def _position(self) -> float:
        glitch = self.position_glitch_pulses * 2.0 * math.pi / 4096
        return self.shaft.angle_rad - self._origin_rad + glitch


def _spread(value: int, limit: float, bits: int) -> float:
    return 2.0 * limit * value / ((1 << bits) - 1) - limit


def _packed(value: float, limit: float, bits: int) -> int:
    top = (1 << bits) - 1
    return max(0, min(top, round((value + limit) / (2.0 * limit) * top)))


def _byte(value: float) -> int:
    return max(0, min(255, round(value)))
