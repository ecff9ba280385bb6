# SPDX-License-Identifier: Apache-2.0
"""Several servos on one half-duplex bus: who answers which packet, in which order, and when."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from softgrip_emulator.dynamixel.packets import (
    BROADCAST_ID,
    Instruction,
    Packet,
    PacketReader,
    StatusError,
    encode_fast_status,
    encode_status,
)
from softgrip_emulator.emulated_chain import EmulatedChain
from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk, collided

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterator, Sequence

    from softgrip_emulator.dynamixel.instructions import InstructionReply
    from softgrip_emulator.dynamixel.servo import EmulatedServo

_MAX_STATUS_BYTES: Final = 1024
_FULL_RESET: Final = b"\xff"


class DynamixelChain(EmulatedChain["EmulatedServo", Packet]):
    """The servos of the X series; replies to a broadcast ping come in the order of their IDs."""

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        *,
        lock: threading.RLock | None = None,
        before: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(servos, PacketReader(), lock, before)

    # -- who answers -----------------------------------------------------------------------------------------------

    def _listening(self, now_s: float, baud: int) -> list[EmulatedServo]:
        return [servo for servo in self.servos if servo.listens(now_s, baud)]

    def _answer(self, packet: Packet, now_s: float, baud: int) -> list[Chunk]:
        listening = self._listening(now_s, baud)
        if not packet.crc_ok:
            return [
                self._status(servo, StatusError.CRC, b"", now_s)
                for servo in listening
                if servo.device_id == packet.device_id and servo.answers(packet.instruction)
            ]
        for servo in listening:
            servo.heard(now_s)
        if packet.device_id == BROADCAST_ID:
            return self._broadcast(packet, listening, now_s, baud)
        chunks: list[Chunk] = []
        for servo in listening:
            if servo.device_id != packet.device_id:
                servo.follow(packet, now_s)
                continue
            may_answer = servo.answers(packet.instruction)
            delay_s = servo.return_delay_s
            reply = servo.execute(packet, now_s)
            if may_answer:
                # The reply carries the ID the instruction was addressed to, also when that instruction changed it.
                chunks.append(Chunk(encode_status(packet.device_id, reply.error, reply.parameters), now_s + delay_s))
        return collided(chunks)

    def _broadcast(self, packet: Packet, listening: list[EmulatedServo], now_s: float, baud: int) -> list[Chunk]:
        match packet.instruction:
            case Instruction.PING:
                return self._in_turn(sorted(listening, key=lambda s: s.device_id), packet, now_s, baud)
            case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ:
                requests = _sync_requests(packet.parameters)
                return self._group_read(packet, requests, listening, now_s, baud)
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                return self._group_read(packet, _bulk_requests(packet.parameters), listening, now_s, baud)
            case Instruction.SYNC_WRITE:
                self._group_write(_sync_writes(packet.parameters), listening, now_s)
            case Instruction.BULK_WRITE:
                self._group_write(_bulk_writes(packet.parameters), listening, now_s)
            case Instruction.FACTORY_RESET if packet.parameters == _FULL_RESET:
                # Firmware 42 and newer refuses to make every servo ID 1 at once.
                pass
            case _:
                for servo in listening:
                    servo.execute(packet, now_s)
        return []

    def _in_turn(self, servos: list[EmulatedServo], packet: Packet, now_s: float, baud: int) -> list[Chunk]:
        chunks = []
        answered: set[int] = set()
        start_s = now_s
        for servo in servos:
            reply = servo.execute(packet, now_s)
            chunk = self._status(servo, reply.error, reply.parameters, start_s)
            if servo.device_id in answered:
                # Its turn is that of the other one with this ID, and what they say is the same.
                continue
            answered.add(servo.device_id)
            chunks.append(chunk)
            start_s = chunk.start_s + len(chunk.data) * BITS_PER_BYTE / baud
        return chunks

    def _group_read(
        self,
        packet: Packet,
        requests: list[tuple[int, int, int]],
        listening: list[EmulatedServo],
        now_s: float,
        baud: int,
    ) -> list[Chunk]:
        by_id = {servo.device_id: servo for servo in listening}
        ids = [device_id for device_id, _, _ in requests]
        if len(set(ids)) != len(ids):
            # An ID may appear once only; a servo cannot know which of its turns to take.
            return []
        if packet.instruction in {Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ}:
            return self._fast_read(requests, by_id, now_s)
        chunks = []
        answered: set[int] = set()
        start_s = now_s
        for device_id, address, length in requests:
            servo = by_id.get(device_id)
            if servo is None or not servo.answers(packet.instruction):
                # Each waits for the answer of the one before: "if one device does not respond in the middle, all IDs
                # do not respond after that" (ROBOTIS-GIT/DynamixelSDK issue 364; a logic analyzer in 331).
                break
            reply = servo.read_for_host(address, length, now_s)
            chunk = self._status(servo, reply.error, reply.parameters, start_s)
            if servo.device_id in answered:
                # Its turn is that of the other one with this ID, and what they say is the same.
                continue
            answered.add(servo.device_id)
            chunks.append(chunk)
            start_s = chunk.start_s + len(chunk.data) * BITS_PER_BYTE / baud
        return chunks

    def _fast_read(
        self, requests: list[tuple[int, int, int]], by_id: dict[int, EmulatedServo], now_s: float
    ) -> list[Chunk]:
        if any(servo.device_id in by_id and not servo.model.has_fast_sync_read for servo in self.servos):
            return []
        if 1 + sum(length + 4 for _, _, length in requests) > _MAX_STATUS_BYTES:
            return []
        replies: list[tuple[int, int, bytes]] = []
        complete = True
        delay_s = 0.0
        for device_id, address, length in requests:
            servo = by_id.get(device_id)
            reply: InstructionReply | None = None if servo is None else servo.read_for_host(address, length, now_s)
            if servo is None or reply is None or not servo.answers(Instruction.FAST_SYNC_READ):
                complete = False
                replies.append((0, device_id, bytes(length)))
                break
            delay_s = max(delay_s, servo.return_delay_s)
            replies.append((reply.error, device_id, reply.parameters or bytes(length)))
        if not complete:
            # Each servo continues the packet of the one before: behind a missing servo the packet breaks off. The
            # length field was sent for all of them.
            filler = [(0, device_id, bytes(length)) for device_id, _, length in requests[len(replies) :]]
            pieces = encode_fast_status(replies + filler)[: len(replies) - 1]
        else:
            pieces = encode_fast_status(replies)
        data = b"".join(pieces)
        return [Chunk(data, now_s + delay_s)] if data else []

    @staticmethod
    def _group_write(writes: list[tuple[int, int, bytes]], listening: list[EmulatedServo], now_s: float) -> None:
        for device_id, address, data in writes:
            for servo in listening:
                if servo.obeys(device_id, address):
                    servo.write_for_host(address, data, now_s)

    @staticmethod
    def _status(servo: EmulatedServo, error: int, parameters: bytes, start_s: float) -> Chunk:
        return Chunk(encode_status(servo.device_id, error, parameters), start_s + servo.return_delay_s)


# -- parameters of group instructions: (id, address, length) or (id, address, data); malformed ones give nothing ------


def _sync_requests(parameters: bytes) -> list[tuple[int, int, int]]:
    if len(parameters) < 5:
        return []
    address, length = _u16(parameters, 0), _u16(parameters, 2)
    return [(device_id, address, length) for device_id in parameters[4:]]


def _bulk_requests(parameters: bytes) -> list[tuple[int, int, int]]:
    if len(parameters) % 5:
        return []
    return [(parameters[i], _u16(parameters, i + 1), _u16(parameters, i + 3)) for i in range(0, len(parameters), 5)]


def _sync_writes(parameters: bytes) -> list[tuple[int, int, bytes]]:
    if len(parameters) < 5:
        return []
    address, length = _u16(parameters, 0), _u16(parameters, 2)
    stride = length + 1
    if (len(parameters) - 4) % stride:
        return []
    return [(parameters[i], address, parameters[i + 1 : i + stride]) for i in range(4, len(parameters), stride)]


def _bulk_writes(parameters: bytes) -> list[tuple[int, int, bytes]]:
    def entries() -> Iterator[tuple[int, int, bytes]]:
        place = 0
        while place < len(parameters):
            if len(parameters) - place < 5:
                raise ValueError
            length = _u16(parameters, place + 3)
            data = parameters[place + 5 : place + 5 + length]
            if len(data) != length:
                raise ValueError
            yield parameters[place], _u16(parameters, place + 1), data
            place += 5 + length

    try:
        return list(entries())
    except ValueError:
        return []


def _u16(data: bytes, place: int) -> int:
    return int.from_bytes(data[place : place + 2], "little")
