# SPDX-License-Identifier: Apache-2.0
"""Decode CDR by the definition that stands in a bag, whatever is installed here.

Source: MCAP specification, "ros2msg"; OMG DDS-XTypes 1.3, 7.4.1 (plain CDR of version 1).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from softgrip_bag.errors import BagError

_FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_LINE = re.compile(r"^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[[^\]]*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$")
_PART = re.compile(r"(?m)^={80}$")


@dataclass(frozen=True)
class Field:
    """One field; ``count`` is the length of an array, 0 of a sequence, None of a single value."""

    name: str
    type_name: str
    count: int | None


@dataclass
class Definition:
    """Fields in order, and constants that are whole numbers."""

    name: str
    fields: list[Field] = field(default_factory=list)
    constants: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Decoded:
    """A message as its own definition says: field -> value, `Decoded`, or a list of either."""

    definition: Definition
    values: Mapping[str, Any]


def parse_definitions(type_name: str, schema: str) -> dict[str, Definition]:
    """Return "package/Name" -> definition, of a type and of all that it contains; the type itself is the first.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/FrictionModel".
        schema: ros2msg text.
    """
    found: dict[str, Definition] = {}
    for number, part in enumerate(_PART.split(schema)):
        lines = [line.split("#", 1)[0].strip() for line in part.splitlines()]
        lines = [line for line in lines if line]
        name = type_name if number == 0 else lines.pop(0).removeprefix("MSG:").strip()
        definition = Definition(_short(name))
        for line in lines:
            _add_line(definition, line, _short(name).split("/")[0])
        found[definition.name] = definition
    return found


def decode(type_name: str, definitions: Mapping[str, Definition], data: bytes) -> Decoded:
    """Return a message.

    Raises:
        BagError: the bytes are no such message.
    """
    try:
        return _Cursor(data, definitions).message(_short(type_name))
    except (struct.error, UnicodeDecodeError, KeyError, IndexError) as error:
        raise BagError(f"expected a {type_name} as the bag defines it, found {error!r}") from error


class _Cursor:
    """Reads on; alignment counts from the end of the four bytes that say how the rest is encoded."""

    def __init__(self, data: bytes, definitions: Mapping[str, Definition]) -> None:
        self._data = data
        self._definitions = definitions
        self._order = "<" if data[1] & 1 else ">"
        self._at = 4

    def message(self, name: str) -> Decoded:
        definition = self._definitions[name]
        if not definition.fields:
            self._number("uint8")  # an empty message has one byte
        return Decoded(definition, {one.name: self._field(one) for one in definition.fields})

    def _field(self, one: Field) -> Any:
        if one.count is None:
            return self._value(one.type_name)
        count = one.count or self._number("uint32")
        if count > len(self._data):
            raise IndexError(f"{one.name}: {count} elements in {len(self._data)} bytes")
        return [self._value(one.type_name) for _ in range(count)]

    def _value(self, type_name: str) -> Any:
        if type_name in _FORMATS:
            return self._number(type_name)
        if type_name == "string":
            length = self._number("uint32")
            start, self._at = self._at, self._at + length
            if self._at > len(self._data):
                raise IndexError(f"a text of {length} bytes")
            return self._data[start : self._at].rstrip(b"\0").decode()
        return self.message(type_name)

    def _number(self, type_name: str) -> Any:
        form = _FORMATS[type_name]
        size = struct.calcsize(form)
        self._at += -(self._at - 4) % size
        (value,) = struct.unpack_from(self._order + form, self._data, self._at)
        self._at += size
        return value


def _add_line(definition: Definition, line: str, package: str) -> None:
    match = _LINE.match(line)
    if match is None:
        raise BagError(f"{definition.name}: expected a field or a constant, found {line!r}")
    if match["rest"].startswith("="):
        text = match["rest"].removeprefix("=").strip()
        if match["type"] in _FORMATS and re.fullmatch(r"-?\d+", text):
            definition.constants[match["name"]] = int(text)
        return
    array = match["array"]
    count = None if array is None else 0 if array == "[]" or array.startswith("[<=") else int(array[1:-1])
    named = match["type"]
    if named not in _FORMATS and named not in {"string", "wstring"}:
        named = _short(named) if "/" in named else f"{package}/{named}"
    definition.fields.append(Field(match["name"], named, count))


def _short(name: str) -> str:
    """Return "package/Name" of "package/msg/Name"."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
