# SPDX-License-Identifier: Apache-2.0
"""Several servos on one half-duplex bus, whatever they speak: packets in, answers out."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from softgrip_emulator.wire.device import Chunk

_PACKET_GAP_S: Final = 0.05
"""A packet interrupted for longer is forgotten (assumption: no manual gives a figure)."""

Servo = TypeVar("Servo")
Packet = TypeVar("Packet")
Packet_co = TypeVar("Packet_co", covariant=True)


class Reader(Protocol[Packet_co]):
    """Finds packets in a stream of bytes."""

    @property
    def pending(self) -> bool:
        """Whether a packet has begun and not ended."""

    def reset(self) -> None:
        """Forget what has begun."""

    def feed(self, data: bytes) -> Iterable[Packet_co]:
        """Return the packets that end within the data."""


class EmulatedChain(ABC, Generic[Servo, Packet]):
    """The device end of a servo bus (a `WireDevice`).

    Args:
        servos: in the order of the cable.
        reader: of the packets that they speak.
        lock: held while servos are read or changed; the plant holds the same one while it steps them.
        before: called with the time [s] of each packet, so that the plant can catch up before it is answered.
    """

    def __init__(
        self,
        servos: Sequence[Servo],
        reader: Reader[Packet],
        lock: threading.RLock | None = None,
        before: Callable[[float], None] | None = None,
    ) -> None:
        self.servos = list(servos)
        self._lock = lock or threading.RLock()
        self._before = before
        self._reader = reader
        self._last_byte_s = 0.0
        self.packets_seen = 0

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """Servos do not care who opens the port."""
        self._reader.reset()
        self._last_byte_s = now_s
        return []

    def due_s(self) -> float | None:
        """Servos speak only when spoken to."""
        return None

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Bytes from the host to replies of the servos."""
        if self._reader.pending and now_s - self._last_byte_s > _PACKET_GAP_S:
            self._reader.reset()
        self._last_byte_s = now_s
        chunks: list[Chunk] = []
        for packet in self._reader.feed(data):
            self.packets_seen += 1
            if self._before is not None:
                self._before(now_s)
            with self._lock:
                chunks += self._answer(packet, now_s, baud)
        return chunks

    @abstractmethod
    def _answer(self, packet: Packet, now_s: float, baud: int) -> list[Chunk]:
        """What the servos answer to a packet."""
