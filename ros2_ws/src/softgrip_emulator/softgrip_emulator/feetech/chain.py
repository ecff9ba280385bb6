# SPDX-License-Identifier: Apache-2.0
"""Several STS servos on one half-duplex bus: who answers which packet, in which order, and when."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from softgrip_emulator.emulated_chain import EmulatedChain
from softgrip_emulator.feetech.packets import (
    BROADCAST_ID,
    FeetechInstruction,
    FeetechPacket,
    FeetechPacketReader,
    encode_status,
)
from softgrip_emulator.feetech.servo import servos_with
from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk, collided

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Sequence

    from softgrip_emulator.feetech.servo import EmulatedFeetechServo

_MISSED_TURN_S: Final = 5e-4
"""Those behind a missing servo wait so long beside the time of its answer, then take their turn (assumption)."""
_OVERHEAD_BYTES: Final = 6


class FeetechChain(EmulatedChain["EmulatedFeetechServo", FeetechPacket]):
    """STS servos."""

    def __init__(
        self,
        servos: Sequence[EmulatedFeetechServo],
        *,
        lock: threading.RLock | None = None,
        before: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(servos, FeetechPacketReader(), lock, before)

    def _answer(self, packet: FeetechPacket, now_s: float, baud: int) -> list[Chunk]:
        listening = [servo for servo in self.servos if servo.listens(now_s, baud)]
        if packet.instruction == FeetechInstruction.SYNC_READ:
            return self._sync_read(packet.parameters, listening, now_s, baud)
        if packet.instruction == FeetechInstruction.SYNC_WRITE:
            self._sync_write(packet.parameters, listening)
            return []
        addressed = listening if packet.device_id == BROADCAST_ID else servos_with(listening, packet.device_id)
        chunks = [chunk for servo in addressed if (chunk := self._executed(servo, packet, now_s)) is not None]
        if packet.device_id == BROADCAST_ID and packet.instruction != FeetechInstruction.PING:
            return []
        return collided(chunks)

    @staticmethod
    def _executed(servo: EmulatedFeetechServo, packet: FeetechPacket, now_s: float) -> Chunk | None:
        """One servo's answer to an instruction; None where it gives none."""
        device_id, parameters = servo.device_id, packet.parameters
        data, may_answer = b"", servo.answers_writes
        match packet.instruction:
            case FeetechInstruction.PING:
                may_answer = True
            case FeetechInstruction.READ if len(parameters) == 2:
                data, may_answer = servo.read(*parameters), True
            case FeetechInstruction.WRITE if parameters:
                servo.write(parameters[0], parameters[1:])
            case FeetechInstruction.REG_WRITE if parameters:
                servo.defer(parameters[0], parameters[1:])
            case FeetechInstruction.ACTION:
                servo.act()
            case FeetechInstruction.RESET_TURNS:
                servo.reset_turns()
            case _:
                return None
        if not may_answer:
            return None
        return Chunk(encode_status(device_id, servo.status, data), now_s + servo.return_delay_s)

    @staticmethod
    def _sync_read(
        parameters: bytes, listening: Sequence[EmulatedFeetechServo], now_s: float, baud: int
    ) -> list[Chunk]:
        if len(parameters) < 3:
            return []
        address, size, *ids = parameters
        chunks, start_s = [], now_s
        answer_s = (_OVERHEAD_BYTES + size) * BITS_PER_BYTE / baud
        for device_id in ids:
            servo = next(iter(servos_with(listening, device_id)), None)
            if servo is None:
                start_s += _MISSED_TURN_S + answer_s
                continue
            data = servo.read(address, size)
            chunks.append(Chunk(encode_status(device_id, servo.status, data), start_s + servo.return_delay_s))
            start_s += servo.return_delay_s + answer_s
        return chunks

    @staticmethod
    def _sync_write(parameters: bytes, listening: Sequence[EmulatedFeetechServo]) -> None:
        if len(parameters) < 3 or (len(parameters) - 2) % (parameters[1] + 1):
            return
        address, size = parameters[0], parameters[1]
        for place in range(2, len(parameters), size + 1):
            for servo in servos_with(listening, parameters[place]):
                servo.write(address, parameters[place + 1 : place + 1 + size])
