# SPDX-License-Identifier: Apache-2.0
"""Finger records: what is known about each printed finger, and whether it may be used."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from datetime import date, datetime
from enum import StrEnum
from pathlib import Path

from softgrip_cell.errors import CatalogueError
from softgrip_cell.yaml_fields import Fields, load

KIND = "softgrip_finger_records"
SCHEMA = 1

#: The fingers that ship with the demonstration cell: one of each kind and a spare.
SHIPPED = Path(__file__).parent / "data" / "finger_records.yaml"


class FingerState(StrEnum):
    """Where a finger is and whether it may be used."""

    STORE = "store"
    MOUNTED = "mounted"
    WORN = "worn"
    RETIRED = "retired"
    UNKNOWN = "unknown"  # nobody can say where it is or what happened to it


@dataclass(frozen=True)
class FingerRecord:
    """One printed finger.

    Attributes:
        serial: printed on the finger.
        profile: id of the finger profile it was printed from.
        finger: which finger of the profile it is, and so the slot it fits.
        cycles: closings so far.
        cycle_limit: closings after which it is worn.
        calibrated: day of the last empty closing that passed, None before the first.
        version: grows by one with every stored change.
    """

    serial: str
    profile: str
    finger: str
    printed: date
    material: str
    cable: str
    state: FingerState = FingerState.STORE
    cycles: int = 0
    cycle_limit: int = 25_000
    calibrated: date | None = None
    version: int = 1

    @property
    def is_spent(self) -> bool:
        """Worn, retired, or closed as often as it may: not to be mounted again, wherever it is."""
        return self.state in (FingerState.WORN, FingerState.RETIRED) or self.cycles >= self.cycle_limit

    def objection(self) -> str | None:
        """Return why this finger may not be mounted, or None."""
        if self.state is FingerState.UNKNOWN:
            return (
                f"finger {self.serial} is unknown: a check refused it, or nobody saw where it went; look at it, then "
                f"say where it is: `ros2 run softgrip_cell library finger {self.serial} store`"
            )
        if self.state in (FingerState.WORN, FingerState.RETIRED):
            return f"finger {self.serial} is {self.state.value}; expected one in store"
        if self.cycles >= self.cycle_limit:
            return f"finger {self.serial} has closed {self.cycles} times, its limit is {self.cycle_limit}; retire it"
        return None


def read_finger_records(path: Path = SHIPPED) -> dict[str, FingerRecord]:
    """Read and check a finger record file.

    Raises:
        CatalogueError: with the place in the file, what was expected and what was found.
    """
    fields = load(path, KIND, SCHEMA)
    entries = fields.mapping("fingers")
    finger_records = {serial: _finger_record(serial, entries.mapping(serial)) for serial in entries.names()}
    fields.finish()
    return finger_records


def finger_record_document(finger_record: FingerRecord) -> dict[str, object]:
    """Return a finger record as a plain mapping, the form that read_finger_records reads."""
    return {
        "profile": finger_record.profile,
        "finger": finger_record.finger,
        "printed": finger_record.printed.isoformat(),
        "material": finger_record.material,
        "cable": finger_record.cable,
        "state": finger_record.state.value,
        "cycles": finger_record.cycles,
        "cycle_limit": finger_record.cycle_limit,
        "calibrated": finger_record.calibrated.isoformat() if finger_record.calibrated else "never",
        "version": finger_record.version,
    }


def _finger_record(serial: str, fields: Fields) -> FingerRecord:
    finger_record = FingerRecord(
        serial=serial,
        profile=fields.text("profile"),
        finger=fields.text("finger"),
        printed=_day(fields, "printed"),
        material=fields.text("material"),
        cable=fields.text("cable"),
        state=fields.choice("state", FingerState) if fields.has("state") else FingerState.STORE,
        cycles=fields.count("cycles") if fields.has("cycles") else 0,
        cycle_limit=fields.count("cycle_limit", 1) if fields.has("cycle_limit") else 25_000,
        calibrated=None
        if not fields.has("calibrated") or fields.raw("calibrated") == "never"
        else _day(fields, "calibrated"),
        version=fields.count("version", 1) if fields.has("version") else 1,
    )
    fields.finish()
    return finger_record


def _day(fields: Fields, name: str) -> date:
    value = fields.raw(name)
    if isinstance(value, date) and not isinstance(value, datetime):  # YAML's time of day is a date, too
        return value
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            return date.fromisoformat(value)
    raise CatalogueError(f"{fields.where}.{name}: expected a day as 2026-11-21, found {value!r}")
