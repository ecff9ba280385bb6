# SPDX-License-Identifier: Apache-2.0
"""The instructions a servo obeys (e-manual, protocol2.md), apart from the group ones (chain.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from softgrip_emulator.dynamixel.packets import Instruction, Packet, StatusError
from softgrip_emulator.dynamixel.registers import Registers, WriteRefusedError
from softgrip_emulator.dynamixel.table import EmulatedServoModel

if TYPE_CHECKING:
    from collections.abc import Callable

_CLEAR_KEY: Final = bytes([0x01, 0x44, 0x58, 0x4C, 0x22])
_BACKUP_KEY: Final = bytes([0x43, 0x54, 0x52, 0x4C])
_RESET_KEEPS: Final = {
    0xFF: frozenset[str](),
    0x01: frozenset({"id"}),
    0x02: frozenset({"id", "baud_rate"}),
}


@dataclass(frozen=True, slots=True)
class InstructionReply:
    """Status a servo gives: error field and parameters."""

    error: int
    parameters: bytes = b""


class InstructedServo(Protocol):
    """What instructions need of the servo that obeys them."""

    registers: Registers
    model: EmulatedServoModel

    @property
    def alert(self) -> int:
        """Bit of the status that says that there is a hardware error."""

    def read_for_host(self, address: int, length: int, now_s: float) -> InstructionReply:
        """Give the items from an address on."""

    def write_for_host(self, address: int, data: bytes, now_s: float) -> InstructionReply:
        """Take the items from an address on."""

    def moving(self) -> bool:
        """Whether the shaft turns."""

    def fold(self) -> None:
        """Take whole turns out of the present position."""

    def lose_power(self, now_s: float) -> None:
        """Boot again."""


class Instructions:
    """Obeys instructions for one servo and keeps what they leave behind: a registered write, a backup."""

    def __init__(self, servo: InstructedServo) -> None:
        self._servo = servo
        self._registered: tuple[int, bytes] | None = None
        self._backup: bytes | None = None

    def forget(self) -> None:
        """The power was away: a registered write is gone, a backup is not."""
        self._registered = None

    def restore_ram(self) -> None:
        """Bring the volatile items of a backup back (Startup Configuration, RAM restore)."""
        if self._backup is not None:
            self._servo.registers.restore_ram(self._backup)

    def execute(self, packet: Packet, now_s: float) -> InstructionReply:
        """Obey one instruction."""
        handlers: dict[int, Callable[[bytes, float], InstructionReply]] = {
            Instruction.PING: self._ping,
            Instruction.READ: self._read,
            Instruction.WRITE: self._write,
            Instruction.REG_WRITE: self._reg_write,
            Instruction.ACTION: self._action,
            Instruction.FACTORY_RESET: self._factory_reset,
            Instruction.REBOOT: self._reboot,
            Instruction.CLEAR: self._clear,
            Instruction.CONTROL_TABLE_BACKUP: self._control_table_backup,
        }
        handler = handlers.get(packet.instruction)
        if handler is None:
            return InstructionReply(StatusError.INSTRUCTION | self._servo.alert)
        return handler(packet.parameters, now_s)

    def _ping(self, _: bytes, __: float) -> InstructionReply:
        return InstructionReply(
            self._servo.alert, self._servo.model.number.to_bytes(2, "little") + bytes([self._servo.model.firmware])
        )

    def _read(self, parameters: bytes, now_s: float) -> InstructionReply:
        if len(parameters) != 4:
            return InstructionReply(StatusError.DATA_LENGTH | self._servo.alert)
        return self._servo.read_for_host(_u16(parameters), _u16(parameters[2:]), now_s)

    def _write(self, parameters: bytes, now_s: float) -> InstructionReply:
        if len(parameters) < 3:
            return InstructionReply(StatusError.DATA_LENGTH | self._servo.alert)
        return self._servo.write_for_host(_u16(parameters), parameters[2:], now_s)

    def _reg_write(self, parameters: bytes, _: float) -> InstructionReply:
        if len(parameters) < 3:
            return InstructionReply(StatusError.DATA_LENGTH | self._servo.alert)
        address, data = _u16(parameters), parameters[2:]
        try:
            self._servo.registers.check(address, data)
        except WriteRefusedError as refusal:
            return InstructionReply(refusal.error | self._servo.alert)
        self._registered = (address, data)
        self._servo.registers.put("registered_instruction", 1)
        return InstructionReply(self._servo.alert)

    def _action(self, _: bytes, now_s: float) -> InstructionReply:
        if self._registered is None:
            return InstructionReply(StatusError.INSTRUCTION | self._servo.alert)
        (address, data), self._registered = self._registered, None
        self._servo.registers.put("registered_instruction", 0)
        return self._servo.write_for_host(address, data, now_s)

    def _factory_reset(self, parameters: bytes, now_s: float) -> InstructionReply:
        if len(parameters) != 1:
            return InstructionReply(StatusError.DATA_LENGTH | self._servo.alert)
        keep = _RESET_KEEPS.get(parameters[0])
        if keep is None:
            return InstructionReply(StatusError.DATA_RANGE | self._servo.alert)
        reply = InstructionReply(self._servo.alert)
        self._servo.registers.factory_reset(keep)
        self._servo.lose_power(now_s)
        return reply

    def _reboot(self, _: bytes, now_s: float) -> InstructionReply:
        reply = InstructionReply(self._servo.alert)
        self._servo.lose_power(now_s)
        return reply

    def _clear(self, parameters: bytes, _: float) -> InstructionReply:
        if parameters != _CLEAR_KEY:
            return InstructionReply(StatusError.DATA_RANGE | self._servo.alert)
        if self._servo.moving():
            return InstructionReply(StatusError.RESULT_FAIL | self._servo.alert)
        self._servo.fold()
        return InstructionReply(self._servo.alert)

    def _control_table_backup(self, parameters: bytes, now_s: float) -> InstructionReply:
        if len(parameters) != 5 or parameters[1:] != _BACKUP_KEY or parameters[0] not in {1, 2}:
            return InstructionReply(StatusError.DATA_RANGE | self._servo.alert)
        if self._servo.registers.get("torque_enable"):
            return InstructionReply(StatusError.RESULT_FAIL | self._servo.alert)
        if parameters[0] == 1:
            self._backup = self._servo.registers.snapshot()
            if self._servo.registers.has("backup_ready"):
                self._servo.registers.put("backup_ready", 1)
            return InstructionReply(self._servo.alert)
        if self._backup is None:
            return InstructionReply(StatusError.RESULT_FAIL | self._servo.alert)
        reply = InstructionReply(self._servo.alert)
        self._servo.registers.restore(self._backup)
        self._servo.lose_power(now_s)
        return reply


def _u16(data: bytes) -> int:
    return int.from_bytes(data[:2], "little")
