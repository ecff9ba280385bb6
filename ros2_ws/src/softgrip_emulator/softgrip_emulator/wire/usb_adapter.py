# SPDX-License-Identifier: Apache-2.0
"""An FTDI USB-serial adapter as it comes, e.g. a U2D2: it keeps bytes back until it has 62 or its timer runs out.

FTDI AN232B-04, "Data Throughput, Latency and Handshaking": a 64-byte packet carries two bytes of status and 62 of data;
a packet that is not full goes when the latency timer runs out, 16 ms by default, which every packet starts again.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk, WireDevice

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
        self._kept: deque[tuple[float, int]] = deque()
        """When the last bit of each byte that it keeps has come [s], and the byte."""
        self._heard_until_s = 0.0
        self._sent_s = 0.0

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """See `WireDevice`."""
        self._kept.clear()
        return self._to_host(self._device.opened(now_s), now_s)

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """See `WireDevice`."""
        self._baud = baud
        device_due_s = self._device.due_s()
        is_asked = data or (device_due_s is not None and device_due_s <= now_s)
        return self._to_host(self._device.exchange(data, now_s, baud) if is_asked else [], now_s)

    def due_s(self) -> float | None:
        """See `WireDevice`; also when its timer runs out while it keeps bytes."""
        device_due_s = self._device.due_s()
        if not self._kept:
            return device_due_s
        return self._timer_s() if device_due_s is None else min(device_due_s, self._timer_s())

    def _to_host(self, chunks: Sequence[Chunk], now_s: float) -> Sequence[Chunk]:
        if self.latency_s <= 0.0:
            left = [self._packet(len(self._kept), now_s)] if self._kept else []
            return [*left, *chunks]
        for chunk in chunks:
            for byte in chunk.data:
                self._heard_until_s = max(self._heard_until_s, chunk.start_s) + BITS_PER_BYTE / self._baud
                self._kept.append((self._heard_until_s, byte))
        return list(self._packets(now_s))

    def _packets(self, now_s: float) -> Iterator[Chunk]:
        """Yield what goes to the host: full packets at once, the rest when the timer runs out."""
        while self._kept:
            timer_s = self._timer_s()
            full_s = self._kept[PACKET_BYTES - 1][0] if len(self._kept) >= PACKET_BYTES else math.inf
            if full_s <= timer_s:
                yield self._packet(PACKET_BYTES, full_s)
            elif timer_s <= now_s:
                yield self._packet(sum(heard_s <= timer_s for heard_s, _ in self._kept), timer_s)
            else:
                return

    def _timer_s(self) -> float:
        """When the timer runs out next after the first byte that is kept [s]."""
        rounds = math.ceil((self._kept[0][0] - self._sent_s) / self.latency_s)
        return self._sent_s + max(1, rounds) * self.latency_s

    def _packet(self, size: int, at_s: float) -> Chunk:
        """Send some bytes so that their last bit reaches the host at a time [s]; `Line` adds the wire's pace."""
        self._sent_s = at_s
        data = bytes(self._kept.popleft()[1] for _ in range(size))
        return Chunk(data, at_s - len(data) * BITS_PER_BYTE / self._baud)
