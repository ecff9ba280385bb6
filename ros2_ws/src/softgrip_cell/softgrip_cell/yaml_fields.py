# SPDX-License-Identifier: Apache-2.0
"""Reading typed fields out of YAML mappings, with errors that say where, what was expected and what was found."""

from __future__ import annotations

import sys
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import yaml

from softgrip_cell.errors import CatalogueError

#: former -> present name of fields and of kinds of files
PRESENT_NAMES = {
    "hold_excess_n": "hold_contact_tension_n",
    "pulled_m": "pulled_length_m",
    "softgrip_passports": "softgrip_finger_records",
}


def with_present_names(values: dict[str, object]) -> dict[str, object]:
    """Return a mapping with former names of its fields replaced; a field given under both names keeps both."""
    return {
        PRESENT_NAMES[key] if key in PRESENT_NAMES and PRESENT_NAMES[key] not in values else key: value
        for key, value in values.items()
    }


Choice = TypeVar("Choice", bound=Enum)


class Fields:
    """One mapping of a YAML file, read field by field; a field nobody asked for is an error."""

    def __init__(self, where: str, value: object) -> None:
        if not isinstance(value, dict):
            raise CatalogueError(f"{where}: expected a mapping, found {_kind(value)}")
        self.where = where
        self._values: dict[Any, Any] = with_present_names(value)
        self._asked: set[str] = set()

    def names(self) -> list[str]:
        """Return the keys, which all have to be text; marks them as asked for."""
        for key in self._values:
            if not isinstance(key, str) or not key:
                raise CatalogueError(f"{self.where}: expected names as keys, found {key!r}")
        self._asked.update(self._values)
        return list(self._values)

    def raw(self, name: str) -> object:
        """Return a field's value, which has to be there."""
        self._asked.add(name)
        if name not in self._values:
            raise CatalogueError(f"{self.where}: field '{name}' is missing")
        return self._values[name]

    def has(self, name: str) -> bool:
        """Return whether a field is there."""
        self._asked.add(name)
        return name in self._values

    def text(self, name: str) -> str:
        """Return a non-empty text."""
        value = self.raw(name)
        if not isinstance(value, str) or not value.strip():
            raise CatalogueError(f"{self.where}.{name}: expected text, found {_kind(value)}")
        return value

    def number(self, name: str, low: float, high: float, unit: str) -> float:
        """Return a finite number inside low..high."""
        return checked_number(f"{self.where}.{name}", self.raw(name), low, high, unit)

    def count(self, name: str, low: int = 0) -> int:
        """Return a whole number >= low."""
        value = self.raw(name)
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise CatalogueError(f"{self.where}.{name}: expected a whole number >= {low}, found {value!r}")
        return value

    def choice(self, name: str, kind: type[Choice]) -> Choice:
        """Return a member of an enumeration by its value."""
        value = self.raw(name)
        try:
            return kind(value)
        except ValueError:
            options = ", ".join(str(member.value) for member in kind)
            raise CatalogueError(f"{self.where}.{name}: expected one of {options}, found {value!r}") from None

    def mapping(self, name: str) -> Fields:
        """Return a nested mapping."""
        return Fields(f"{self.where}.{name}", self.raw(name))

    def finish(self) -> None:
        """Raise when the mapping holds fields that nobody asked for."""
        unknown = sorted(str(key) for key in self._values if key not in self._asked)
        if unknown:
            known = ", ".join(sorted(self._asked))
            raise CatalogueError(f"{self.where}: unknown field {', '.join(unknown)}; known are {known}")


def checked_number(where: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a value as a finite float inside low..high [unit], else raise CatalogueError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise CatalogueError(f"{where}: expected a number [{unit}], found {_kind(value)}")
    if not low <= value <= high:
        raise CatalogueError(f"{where}: expected {low:g}..{high:g} {unit}, found {value:g}")
    return float(value)


def load(path: Path, kind: str, schema: int) -> Fields:
    """Read a YAML file of the given kind and schema number.

    Raises:
        CatalogueError: the file cannot be read, is no YAML, or is of another kind or schema.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise CatalogueError(f"{path}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise CatalogueError(f"{path}: expected YAML: {error}") from error
    fields = Fields(path.name, document)
    found_kind, found_schema = fields.raw("kind"), fields.raw("schema")
    if PRESENT_NAMES.get(str(found_kind), found_kind) != kind:
        raise CatalogueError(f"{path}: expected kind '{kind}', found {found_kind!r}")
    if found_schema != schema or isinstance(found_schema, bool):
        raise CatalogueError(
            f"{path}: expected schema {schema}, found {found_schema!r}; use a matching softgrip release"
        )
    return fields


def _kind(value: object) -> str:
    return "nothing" if value is None else f"{type(value).__name__} {value!r:.60}"
