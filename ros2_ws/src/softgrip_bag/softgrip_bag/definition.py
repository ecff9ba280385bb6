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
_PADDING = 4
_PART = re.compile(r"(?m)^={80}$")


@dataclass(frozen=True)
class Field:
    """One field.

    Attributes:
        name, type_name: as declared; a message type as "package/Name".
        count: length of an array, 0 of a sequence, None of a single value.
        comment: what stands behind it, e.g. "[m] pulled tendon length".
        enumeration: names of its values, where constants of its type stand directly before it.
    """

    name: str
    type_name: str
    count: int | None
    comment: str = ""
    enumeration: Mapping[int, str] = field(default_factory=dict)


@dataclass
class Definition:
    """Fields in order, and constants that are whole numbers."""

    name: str
    fields: list[Field] = field(default_factory=list)
    constants: dict[str, int] = field(default_factory=dict)
    #: type and names of the constants since the last field
    pending: tuple[str, dict[int, str]] = ("", {})


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
        lines = [line.partition("#") for line in part.splitlines()]
        lines = [line for line in lines if line[0].strip()]
        name = type_name if number == 0 else lines.pop(0)[0].strip().removeprefix("MSG:").strip()
        definition = Definition(_short(name))
        for line, _, comment in lines:
            _add_line(definition, line.strip(), comment.strip(), _short(name).split("/")[0])
        found[definition.name] = definition
    return found


def decode(type_name: str, definitions: Mapping[str, Definition], data: bytes, *, whole: bool = False) -> Decoded:
    """Return a message.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/FrictionModel".
        definitions: of it and all that it contains.
        data: CDR with its four bytes of encapsulation.
        whole: the message has to be all of the bytes, but for padding to four.

    Raises:
        BagError: the bytes are no such message.
    """
    cursor = _Cursor(data, definitions)
    try:
        message = cursor.message(_short(type_name))
    except (struct.error, UnicodeDecodeError, KeyError, IndexError) as error:
        raise BagError(f"expected a {type_name} as the bag defines it, found {error!r}") from error
    if whole and cursor.left >= _PADDING:
        raise BagError(f"expected a {type_name} of {len(data)} bytes, found {cursor.left} bytes behind it")
    return message


class _Cursor:
    """Reads on; alignment counts from the end of the four bytes that say how the rest is encoded."""

    def __init__(self, data: bytes, definitions: Mapping[str, Definition]) -> None:
        self._data = data
        self._definitions = definitions
        self._order = "<" if data[1] & 1 else ">"
        self._at = 4

    @property
    def left(self) -> int:
        """How many bytes are not read."""
        return len(self._data) - self._at

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
        if one.type_name in _FORMATS:
            return self._numbers(one.type_name, count)
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
        return self._numbers(type_name, 1)[0]

    def _numbers(self, type_name: str, count: int) -> list[Any]:
        if count == 0:
            return []  # CDR aligns elements, not their absence
        form = _FORMATS[type_name]
        size = struct.calcsize(form)
        self._at += -(self._at - 4) % size
        values = struct.unpack_from(f"{self._order}{count}{form}", self._data, self._at)
        self._at += size * count
        return list(values)


def _add_line(definition: Definition, line: str, comment: str, package: str) -> None:
    match = _LINE.match(line)
    if match is None:
        raise BagError(f"{definition.name}: expected a field or a constant, found {line!r}")
    if match["rest"].startswith("="):
        text = match["rest"].removeprefix("=").strip()
        if match["type"] in _FORMATS and re.fullmatch(r"-?\d+", text):
            definition.constants[match["name"]] = int(text)
            kind, names = definition.pending
            if kind != match["type"]:
                names = {}
            definition.pending = (match["type"], names | {int(text): match["name"]})
        return
    array = match["array"]
    count = None if array is None else 0 if array == "[]" or array.startswith("[<=") else int(array[1:-1])
    named = match["type"]
    if named not in _FORMATS and named not in {"string", "wstring"}:
        named = _short(named) if "/" in named else f"{package}/{named}"
    kind, names = definition.pending
    definition.pending = ("", {})
    definition.fields.append(Field(match["name"], named, count, comment, names if kind == named else {}))


def _short(name: str) -> str:
    """Return "package/Name" of "package/msg/Name"."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
