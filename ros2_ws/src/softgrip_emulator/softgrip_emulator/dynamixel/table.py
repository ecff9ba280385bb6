# SPDX-License-Identifier: Apache-2.0
"""Control tables of the X series as data: which item stands where, who may write it, what it starts with."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import yaml

from softgrip_emulator.model_files import described, read_description

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_FOLDER: Final = Path(__file__).parent / "models"
EEPROM_END: Final = 64
"""Addresses below keep their value without power and can be written only with torque off."""
BAUD_OF_REGISTER: Final = {
    0: 9_600,
    1: 57_600,
    2: 115_200,
    3: 1_000_000,
    4: 2_000_000,
    5: 3_000_000,
    6: 4_000_000,
    7: 4_500_000,
}
PULSES_PER_TURN: Final = 4096
VELOCITY_UNIT_RPM: Final = 0.229
ACCELERATION_UNIT_REV_PER_MIN2: Final = 214.577
PWM_FULL_SCALE: Final = 885
_CURRENT_ITEMS: Final = {"current_limit", "goal_current", "present_current"}
LIMITED_BY: Final = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}
"""Items whose magnitude may not exceed that of a Limit item (Data Limit Error)."""


@dataclass(frozen=True, slots=True)
class TableItem:
    """One item of a control table; `low` and `high` bound its own range."""

    name: str
    address: int
    size: int
    writable: bool
    signed: bool
    low: int
    high: int
    default: int

    @property
    def end(self) -> int:
        """First address behind the item."""
        return self.address + self.size


@dataclass(frozen=True, slots=True)
class IndirectBlock:
    """`count` Indirect Address items of two bytes each and as many Indirect Data bytes."""

    addresses: int
    data: int
    count: int


@dataclass(frozen=True, slots=True)
class OverloadWatch:
    """What a servo takes for an overload, and shuts itself down for; no data sheet says it.

    Attributes:
        share: of the stall current that is too much.
        seconds: for which it may be.
    """

    share: float
    seconds: float


#: Of models that nobody was found to have seen shutting down.
_OVERLOAD: Final = OverloadWatch(0.75, 2.5)


@dataclass(frozen=True, slots=True)
class MotorRatings:
    """Motor and gear as the plant needs them, at the output shaft; units are in the names."""

    current_unit_a: float
    nominal_voltage_v: float
    stall_torque_nm: float
    stall_current_a: float
    no_load_speed_rpm: float
    gear_friction_nm: float
    gear_viscous_nms: float
    inertia_kgm2: float
    heat_capacity_j_per_k: float
    thermal_resistance_k_per_w: float
    winding_to_case_k_per_w: float
    winding_capacity_j_per_k: float
    brown_out_v: float

    @property
    def resistance_ohm(self) -> float:
        """Winding resistance from the stall point."""
        return self.nominal_voltage_v / self.stall_current_a

    @property
    def torque_constant_nm_per_a(self) -> float:
        """Output torque per current, gear friction aside."""
        return (self.stall_torque_nm + self.gear_friction_nm) / self.stall_current_a

    @property
    def back_emf_vs_per_rad(self) -> float:
        """From the no-load point: the voltage that is left after the friction current."""
        speed = self.no_load_speed_rpm * 0.10471975512
        friction_nm = self.gear_friction_nm + self.gear_viscous_nms * speed
        friction_drop_v = self.resistance_ohm * friction_nm / self.torque_constant_nm_per_a
        return (self.nominal_voltage_v - friction_drop_v) / speed


@dataclass(frozen=True, slots=True)
class EmulatedServoModel:
    """A servo model: its control table and its motor.

    `senses`: whose current Present Current (126) is, the power input's ("supply") or the winding's ("winding"); with
    "none" Present Load is in its place, and neither Current Limit nor Goal Current is there.
    """

    name: str
    number: int
    firmware: int
    fast_sync_read_firmware: int
    items: tuple[TableItem, ...]
    indirect: tuple[IndirectBlock, ...]
    operating_modes: frozenset[int]
    motor: MotorRatings
    senses: str
    overload: OverloadWatch
    size: int = field(init=False)
    """First address behind the table; every access asks for it."""

    def __post_init__(self) -> None:
        ends = [item.end for item in self.items] + [block.data + block.count for block in self.indirect]
        object.__setattr__(self, "size", max(ends))

    @property
    def senses_supply_current(self) -> bool:
        """Whether Present Current is that of the power input."""
        return self.senses == "supply"

    @property
    def has_current(self) -> bool:
        """Whether it knows a current at all."""
        return self.senses != "none"

    @property
    def has_fast_sync_read(self) -> bool:
        """Fast Sync and Bulk Read came with a later firmware."""
        return self.firmware >= self.fast_sync_read_firmware


def available_models() -> list[str]:
    """File names of the models that are described."""
    return described(_FOLDER, besides={"x_series"})


@cache
def load_model(name: str, firmware: int | None = None) -> EmulatedServoModel:
    """Read a model by name ("XL330-M288") or file name ("xl330_m288"), as of a firmware version (None: that described).

    Raises:
        EmulatorError: no such model.
    """
    own = read_description(_FOLDER, name, besides={"x_series"})
    series = yaml.safe_load((_FOLDER / "x_series.yaml").read_text())
    firmware = own["firmware"] if firmware is None else firmware
    defaults = {**own["defaults"], "model_number": own["number"], "firmware_version": firmware}
    defaults.setdefault("status_return_level", 2)
    # Goals start at their limits (e-manual, "Goal PWM(100)", "Goal Current(102)").
    defaults["goal_pwm"] = own["defaults"]["pwm_limit"]
    defaults["goal_current"] = own["defaults"].get("current_limit", 0)
    absent = set(own.get("absent", [])) | (_CURRENT_ITEMS if own["senses"] == "none" else {"present_load"})
    items = [_item(row, defaults, own.get("ranges", {})) for row in series["items"] if row[2] not in absent]
    blocks = tuple(_indirect_blocks(own["indirect"], firmware))
    items += [_indirect_address(block, index) for block in blocks for index in range(block.count)]
    return EmulatedServoModel(
        name=own["name"],
        number=own["number"],
        firmware=firmware,
        fast_sync_read_firmware=own["fast_sync_read_firmware"],
        items=tuple(sorted(items, key=lambda item: item.address)),
        indirect=blocks,
        operating_modes=frozenset(own["operating_modes"]),
        motor=MotorRatings(**own["motor"]),
        senses=own["senses"],
        overload=OverloadWatch(**own["overload"]) if "overload" in own else _OVERLOAD,
    )


def _item(row: list[Any], defaults: dict[str, int], ranges: dict[str, list[int]]) -> TableItem:
    address, size, name, access, low, high, flags = row
    signed = "s" in flags
    low, high = ranges.get(name, [low, high])
    bits = 8 * size
    return TableItem(
        name=name,
        address=address,
        size=size,
        writable=access == "rw",
        signed=signed,
        low=low if low is not None else (-(1 << (bits - 1)) if signed else 0),
        high=high if high is not None else ((1 << (bits - 1)) - 1 if signed else (1 << bits) - 1),
        default=defaults.get(name, 0),
    )


def _indirect_blocks(rows: Sequence[Mapping[str, int]], firmware: int) -> Iterator[IndirectBlock]:
    """Yield the blocks of a firmware version: `from_firmware`, `to_firmware` bound a row where versions differ."""
    for row in rows:
        if row.get("from_firmware", 0) <= firmware <= row.get("to_firmware", firmware):
            yield IndirectBlock(row["addresses"], row["data"], row["count"])


def _indirect_address(block: IndirectBlock, index: int) -> TableItem:
    # Each entry starts out pointing at its own data byte (e-manual, "Indirect Address").
    return TableItem(
        name=f"indirect_address_{block.addresses + 2 * index}",
        address=block.addresses + 2 * index,
        size=2,
        writable=True,
        signed=False,
        low=EEPROM_END,
        high=661,
        default=block.data + index,
    )
