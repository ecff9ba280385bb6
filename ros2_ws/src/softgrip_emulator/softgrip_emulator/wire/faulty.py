# SPDX-License-Identifier: Apache-2.0
"""A bad cable: loses, flips, delays and doubles bytes on their way, and spoils checksums, on demand and from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from softgrip_emulator.wire.device import Chunk, WireDevice

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass
class WireFaults:
    """What the cable does; all neutral by default. Shares are probabilities per byte, or per packet where said.

    Attributes:
        lost, flipped, duplicated: share of the bytes in both directions.
        spoiled: share of the device's packets whose last byte (a checksum in most protocols) is wrong.
        delay_s: added to every answer.
        delayed: share of the device's packets that get `delay_s`.
        dead: nothing passes.
    """

    lost: float = 0.0
    flipped: float = 0.0
    duplicated: float = 0.0
    spoiled: float = 0.0
    delay_s: float = 0.0
    delayed: float = 1.0
    dead: bool = False

    @property
    def touches_bytes(self) -> bool:
        """Whether single bytes are changed."""
        return self.lost > 0.0 or self.flipped > 0.0 or self.duplicated > 0.0


class FaultyWire:
    """A `WireDevice` around another one, with a cable between that can be bad."""

    def __init__(self, device: WireDevice, seed: int) -> None:
        self.faults = WireFaults()
        self._device = device
        self._rng = np.random.default_rng([seed, 0x5749])

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """See `WireDevice`."""
        return self._outward(self._device.opened(now_s))

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """See `WireDevice`."""
        if self.faults.dead:
            return []
        return self._outward(self._device.exchange(self._mangled(data), now_s, baud))

    def due_s(self) -> float | None:
        """See `WireDevice`."""
        return self._device.due_s()

    def _outward(self, chunks: Sequence[Chunk]) -> Sequence[Chunk]:
        faults = self.faults
        if faults.dead:
            return []
        result = []
        for chunk in chunks:
            data, start_s = self._mangled(chunk.data), chunk.start_s
            if data and faults.spoiled > 0.0 and self._rng.random() < faults.spoiled:
                data = data[:-1] + bytes([data[-1] ^ 0x5A])
            if faults.delay_s > 0.0 and self._rng.random() < faults.delayed:
                start_s += faults.delay_s
            result.append(Chunk(data, start_s))
        return result

    def _mangled(self, data: bytes) -> bytes:
        faults = self.faults
        if not faults.touches_bytes or not data:
            return data
        out = bytearray()
        for byte, (lost, flipped, doubled) in zip(data, self._rng.random((len(data), 3)), strict=True):
            if lost < faults.lost:
                continue
            value = byte ^ (1 << int(self._rng.integers(8))) if flipped < faults.flipped else byte
            out.append(value)
            if doubled < faults.duplicated:
                out.append(value)
        return bytes(out)
