# SPDX-License-Identifier: Apache-2.0
"""What stands at the device end of a wire: bytes in, timed bytes out, no input or output of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import and_
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

BITS_PER_BYTE = 10
"""Start bit, 8 data bits, no parity, one stop bit (8N1): what every device of the cell uses."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes a device sends in one go.

    Attributes:
        data: the bytes.
        start_s: earliest cell time [s] at which the first bit may be on the wire.
    """

    data: bytes
    start_s: float = 0.0


def collided(chunks: list[Chunk]) -> list[Chunk]:
    """Return what is on the wire where servos with one ID answer at once: a driven low wins over a high."""
    if len(chunks) < 2:
        return chunks
    longest = max(len(chunk.data) for chunk in chunks)
    padded = [chunk.data.ljust(longest, b"\xff") for chunk in chunks]
    data = bytes(reduce(and_, column) for column in zip(*padded, strict=True))
    return [Chunk(data, min(chunk.start_s for chunk in chunks))]


class WireDevice(Protocol):
    """A device on a serial wire. All calls come from one thread; times are cell time [s]."""

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """The host has opened the port (an Arduino resets here); returns what the device says."""
        ...

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Take what arrived and give back what the device sends.

        Args:
            data: bytes from the host; empty when called because `due_s` has come.
            now_s: when the last bit of `data` arrived [s].
            baud: the speed the host has set [bit/s]; a device that listens at another speed hears noise.
        """
        ...

    def due_s(self) -> float | None:
        """When the device next has something to say unasked [s]; None when only spoken to."""
        ...


class Port(Protocol):
    """What a hand can do to a port that serves a device."""

    def plug(self) -> None:
        """Make the port appear (again)."""

    def unplug(self) -> None:
        """Make the port vanish; a host that has it open loses it."""

    def close(self) -> None:
        """Stop serving."""
