# SPDX-License-Identifier: Apache-2.0
"""The memory behind a control table: reading, checked writing, indirect addressing, what survives without power."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from softgrip_emulator.dynamixel.packets import StatusError
from softgrip_emulator.dynamixel.table import EEPROM_END, LIMITED_BY, EmulatedServoModel, TableItem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_POSITION_MODE: Final = 3
_GOALS: Final = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})


GAIN_ITEMS: Final = (
    "velocity_i_gain",
    "velocity_p_gain",
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
    "profile_acceleration",
    "profile_velocity",
)
"""What a change of the mode resets, and a backup keeps of the RAM (e-manual, "Backup and Restore")."""


class PresentValues(NamedTuple):
    """The read-only items from address 120 to 146, in order, raw units; `current` is the load where there is none."""

    realtime_tick: int
    moving: int
    moving_status: int
    pwm: int
    current: int
    velocity: int
    position: int
    velocity_trajectory: int
    position_trajectory: int
    input_voltage: int
    temperature: int


_PRESENT: Final = struct.Struct("<HBBhhiiiiHB")
_PRESENT_ADDRESS: Final = 120


class WriteRefusedError(Exception):
    """A write breaks a rule of the table; carries the status error to answer with."""

    def __init__(self, error: StatusError) -> None:
        super().__init__(error.name)
        self.error = error


class Registers:
    """Values of one servo's control table.

    `get` and `put` are the firmware's own access (unchecked); `read` and `write` are the host's.
    """

    def __init__(self, model: EmulatedServoModel) -> None:
        self.model = model
        self._by_name = {item.name: item for item in model.items}
        self._at: dict[int, TableItem] = {item.address: item for item in model.items}
        self._memory = bytearray(model.size)
        self._defined = bytearray(model.size)
        for item in model.items:
            self._defined[item.address : item.end] = b"\1" * item.size
        for block in model.indirect:
            self._defined[block.data : block.data + block.count] = b"\1" * block.count
        self._values: dict[str, int] = {}
        self.changes = 0
        """Counts every `put`: what was decoded from the registers stays good until it moves on."""
        for item in model.items:
            self.put(item.name, item.default)

    # -- the firmware's access -------------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Whether this model has the item."""
        return name in self._by_name

    def get(self, name: str) -> int:
        """Value of an item, with its sign. Of the present values use the sensors instead: see `put_present`."""
        return self._values[name]

    def put(self, name: str, value: int) -> None:
        """Set an item, wrapped into its size."""
        self.changes += 1
        item = self._by_name[name]
        bits = 8 * item.size
        value &= (1 << bits) - 1
        self._memory[item.address : item.end] = value.to_bytes(item.size, "little")
        self._values[name] = value - (1 << bits) if item.signed and value >> (bits - 1) else value

    def put_present(self, block: PresentValues) -> None:
        """Set all items from Realtime Tick to Present Temperature in one go."""
        _PRESENT.pack_into(self._memory, _PRESENT_ADDRESS, *block)

    def lose_power(self) -> None:
        """RAM returns to its defaults; EEPROM stays."""
        for item in self.model.items:
            if item.address >= EEPROM_END:
                self.put(item.name, item.default)
        self.put_goals_to_limits()

    def put_goals_to_limits(self) -> None:
        """Goal PWM, and Goal Current where there is one, start at their limits (e-manual, items 100 and 102)."""
        self.put("goal_pwm", self.get("pwm_limit"))
        if self.has("goal_current"):
            self.put("goal_current", self.get("current_limit"))

    def factory_reset(self, keep: frozenset[str]) -> None:
        """Every writable item returns to its default, but those named."""
        for item in self.model.items:
            if item.writable and item.name not in keep:
                self.put(item.name, item.default)

    def snapshot(self) -> bytes:
        """Copy of the whole table (Control Table Backup)."""
        return bytes(self._memory)

    def restore(self, snapshot: bytes) -> None:
        """Bring the writable EEPROM part of a snapshot back."""
        self._restore(snapshot, lambda item: item.writable and item.address < EEPROM_END)

    def restore_ram(self, snapshot: bytes) -> None:
        """Bring back what of the RAM part a servo keeps in a backup."""
        self._restore(snapshot, lambda item: item.name in GAIN_ITEMS or item.name.startswith("indirect_address"))

    def _restore(self, snapshot: bytes, requested: Callable[[TableItem], bool]) -> None:
        for item in self.model.items:
            if requested(item):
                self.put(item.name, int.from_bytes(snapshot[item.address : item.end], "little"))

    # -- the host's access -----------------------------------------------------------------------------------------

    def read(self, address: int, length: int) -> bytes | None:
        """Bytes as the host sees them; None when no item lies there (Access Error)."""
        end = address + length
        if length == 0 or end > self.model.size or not any(self._defined[address:end]):
            return None
        return bytes(self._memory[place] for place in self._places(address, length))

    def check(self, address: int, data: bytes) -> list[tuple[TableItem, int]]:
        """The items a write would set and their values.

        Raises:
            WriteRefusedError: with the error code that the e-manual gives for the rule that is broken.
        """
        if not data:
            raise WriteRefusedError(StatusError.DATA_LENGTH)
        if address + len(data) > self.model.size:
            raise WriteRefusedError(StatusError.ACCESS)
        assignments: list[tuple[TableItem, int]] = []
        for start, run in self._runs(address, data):
            assignments += self._items(start, run)
        torque_on = bool(self.get("torque_enable"))
        for item, value in assignments:
            self._refuse_if_forbidden(item, value, torque_on=torque_on)
        return assignments

    def _places(self, address: int, length: int) -> Iterator[int]:
        """Where each byte really lives: Indirect Data bytes live at the address their entry names."""
        for place in range(address, address + length):
            yield self._resolve(place)

    def _resolve(self, place: int) -> int:
        for block in self.model.indirect:
            if block.data <= place < block.data + block.count:
                target = self.get(f"indirect_address_{block.addresses + 2 * (place - block.data)}")
                return target if target < self.model.size else place
        return place

    def _runs(self, address: int, data: bytes) -> Iterator[tuple[int, bytes]]:
        run_start, run = -1, bytearray()
        for place, byte in zip(self._places(address, len(data)), data, strict=True):
            if run and place == run_start + len(run):
                run.append(byte)
                continue
            if run:
                yield run_start, bytes(run)
            run_start, run = place, bytearray([byte])
        yield run_start, bytes(run)

    def _items(self, start: int, run: bytes) -> Iterator[tuple[TableItem, int]]:
        place, end = start, start + len(run)
        while place < end:
            item = self._at.get(place)
            if item is None:
                raise WriteRefusedError(StatusError.ACCESS)
            if item.end > end:
                raise WriteRefusedError(StatusError.DATA_LENGTH)
            raw = run[place - start : item.end - start]
            yield item, int.from_bytes(raw, "little", signed=item.signed)
            place = item.end

    def _refuse_if_forbidden(self, item: TableItem, value: int, *, torque_on: bool) -> None:
        if not item.writable or (torque_on and item.address < EEPROM_END):
            raise WriteRefusedError(StatusError.ACCESS)
        if not item.low <= value <= item.high:
            raise WriteRefusedError(StatusError.DATA_RANGE)
        if item.name == "operating_mode" and value not in self.model.operating_modes:
            raise WriteRefusedError(StatusError.DATA_RANGE)
        if item.name in _GOALS and self.get("bus_watchdog") == -1:
            # After the bus watchdog has tripped, goals are read-only until 0 is written to it.
            raise WriteRefusedError(StatusError.DATA_RANGE)
        limit = LIMITED_BY.get(item.name)
        if limit is not None and abs(value) > self.get(limit):
            raise WriteRefusedError(StatusError.DATA_LIMIT)
        outside_turn = not self.get("min_position_limit") <= value <= self.get("max_position_limit")
        if item.name == "goal_position" and self.get("operating_mode") == _POSITION_MODE and outside_turn:
            raise WriteRefusedError(StatusError.DATA_LIMIT)

    def assign(self, assignments: list[tuple[TableItem, int]], changed: Callable[[str, int], None]) -> None:
        """Carry out a checked write; `changed(name, old value)` lets the firmware react to each item."""
        for item, value in assignments:
            before = self.get(item.name)
            self.put(item.name, value)
            changed(item.name, before)
