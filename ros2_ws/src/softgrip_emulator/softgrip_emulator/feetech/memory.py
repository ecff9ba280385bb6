# SPDX-License-Identifier: Apache-2.0
"""The memory of one STS servo: EPROM that keeps what was written unlocked, RAM that begins again with the power."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from softgrip_emulator.dynamixel.table import MotorRatings
from softgrip_emulator.model_files import described, read_description

_FOLDER: Final = Path(__file__).parent
RAM_START: Final = 40
BAUD_OF_REGISTER: Final = {
    0: 1_000_000,
    1: 500_000,
    2: 250_000,
    3: 128_000,
    4: 115_200,
    5: 76_800,
    6: 57_600,
    7: 38_400,
}


@dataclass(frozen=True, slots=True)
class MemoryItem:
    """One item of the memory table."""

    name: str
    address: int
    size: int
    writable: bool
    low: int
    high: int
    initial: int

    @property
    def end(self) -> int:
        """First address behind it."""
        return self.address + self.size


@dataclass(frozen=True, slots=True)
class EmulatedFeetechModel:
    """A servo model: its memory table and its motor."""

    name: str
    number: int
    items: tuple[MemoryItem, ...]
    motor: MotorRatings


def available_models() -> list[str]:
    """File names of the models that are described."""
    return described(_FOLDER)


@cache
def load_model(name: str) -> EmulatedFeetechModel:
    """Read a model by name ("STS3215").

    Raises:
        EmulatorError: no such model.
    """
    data = read_description(_FOLDER, name)
    items = tuple(
        MemoryItem(item, address, size, access == "rw", low, high, initial)
        for item, (address, size, access, low, high, initial) in data["items"].items()
    )
    return EmulatedFeetechModel(data["name"], data["number"], items, MotorRatings(**data["motor"]))


class Memory:
    """Values of one servo; `get` and `put` are the firmware's own access, `read` and `write` the host's."""

    def __init__(self, model: EmulatedFeetechModel) -> None:
        self._places = {item.name: slice(item.address, item.end) for item in model.items}
        self._by_address = sorted(model.items, key=lambda item: item.address)
        self._bytes = bytearray(max(item.end for item in model.items))
        for item in model.items:
            self.put(item.name, item.initial)
        self._kept = bytes(self._bytes[:RAM_START])

    def get(self, name: str) -> int:
        """Raw value of an item."""
        return int.from_bytes(self._bytes[self._places[name]], "little")

    def put(self, name: str, value: int) -> None:
        """Set an item, wrapped into its size."""
        place = self._places[name]
        size = place.stop - place.start
        self._bytes[place] = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")

    def put_kept(self, name: str, value: int) -> None:
        """Set an item of the EPROM as if it had been written unlocked."""
        self.put(name, value)
        self._kept = bytes(self._bytes[:RAM_START])

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the table; what lies outside reads as zeros (assumption)."""
        return bytes(self._bytes[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes) -> list[str]:
        """Set every item that lies within the bytes and whose value is allowed; return their names.

        Values out of range and read-only items are passed over without an error (assumption: no manual names one).
        """
        written = []
        for item in self._by_address:
            if not (address <= item.address and item.end <= address + len(data) and item.writable):
                continue
            value = int.from_bytes(data[item.address - address : item.end - address], "little")
            if item.low <= value <= item.high:
                self.put(item.name, value)
                written.append(item.name)
        if not self.get("lock"):
            self._kept = bytes(self._bytes[:RAM_START])
        return written

    def lose_power(self) -> None:
        """RAM begins again, EPROM is as it was written last without the lock; the torque limit is the maximum's."""
        self._bytes[:RAM_START] = self._kept
        for item in self._by_address:
            if item.address >= RAM_START:
                self.put(item.name, item.initial)
        self.put("torque_limit", self.get("max_torque"))
