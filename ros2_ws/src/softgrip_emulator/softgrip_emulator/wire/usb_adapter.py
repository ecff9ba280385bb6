# SPDX-License-Identifier: Apache-2.0
"""An FTDI USB-serial adapter as it comes, e.g. a U2D2: it keeps bytes back until it has 62 or its timer runs out.

FTDI AN232B-04, "Data Throughput, Latency and Handshaking": a 64-byte packet carries two bytes of status and 62 of data;
a packet that is not full goes when the latency timer runs out, 16 ms by default, which every packet starts again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk, WireDevice

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

PACKET_BYTES: Final = 62
LATENCY_S: Final = 0.016
"""As it comes; 1 ms is the shortest."""


class UsbAdapter:
    """A `WireDevice` around another one, with the adapter between it and the host."""

    def __init__(self, device: WireDevice, latency_s: float = LATENCY_S) -> None:
        """Put an adapter in front of a device; ``latency_s`` [s] of its timer, 0 = it keeps nothing back."""
        self.latency_s = latency_s
        self._device = device
        self._baud = 9600
        self._heard_until_s = 0.0
        self._sent_s = 0.0

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """See `WireDevice`."""
        return self._to_host(self._device.opened(now_s))

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """See `WireDevice`."""
        self._baud = baud
        return self._to_host(self._device.exchange(data, now_s, baud))

    def due_s(self) -> float | None:
        """See `WireDevice`."""
        return self._device.due_s()

    def _to_host(self, chunks: Sequence[Chunk]) -> Sequence[Chunk]:
        return list(self._packets(chunks)) if self.latency_s > 0.0 else chunks

    def _packets(self, chunks: Iterable[Chunk]) -> Iterable[Chunk]:
        """Yield what goes to the host: full packets at once, the rest when the timer runs out."""
        kept = bytearray()
        for chunk in chunks:
            for byte in chunk.data:
                heard_s = max(self._heard_until_s, chunk.start_s) + BITS_PER_BYTE / self._baud
                if kept and heard_s > (due_s := self._timer_s()):
                    yield self._packet(kept, due_s)
                self._heard_until_s = heard_s
                kept.append(byte)
                if len(kept) == PACKET_BYTES:
                    yield self._packet(kept, heard_s)
        if kept:
            yield self._packet(kept, self._timer_s())

    def _timer_s(self) -> float:
        """When the timer next runs out after the last byte that came [s]."""
        rounds = math.ceil((self._heard_until_s - self._sent_s) / self.latency_s)
        return self._sent_s + max(1, rounds) * self.latency_s

    def _packet(self, kept: bytearray, at_s: float) -> Chunk:
        """Send what was kept so that its last bit reaches the host at a time [s]; `Line` adds the wire's pace."""
        self._sent_s = at_s
        data = bytes(kept)
        kept.clear()
        return Chunk(data, at_s - len(data) * BITS_PER_BYTE / self._baud)
