# SPDX-License-Identifier: Apache-2.0
"""Arrow columns of a ROS message type, from the definition that a bag carries, and a message's values for them.

| in the message | column |
|---|---|
| number, text, bool | the same; unit and comment of the definition in the field's metadata |
| enumeration (constants directly before a number) | the number, and `<field>_name` with the constant's name |
| builtin_interfaces/Time, Duration | timestamp[ns, UTC], duration[ns] |
| a message | struct |
| an array | list |
| an array of bytes (images, traces) | `<field>_length`: the bytes stay in the MCAP |
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import pyarrow as pa

from softgrip_bag.definition import Decoded, Definition, Field
from softgrip_time.units import NANOSECONDS

_ARROW = {
    "bool": pa.bool_(), "byte": pa.uint8(), "char": pa.uint8(), "int8": pa.int8(), "uint8": pa.uint8(),
    "int16": pa.int16(), "uint16": pa.uint16(), "int32": pa.int32(), "uint32": pa.uint32(), "int64": pa.int64(),
    "uint64": pa.uint64(), "float32": pa.float32(), "float64": pa.float64(), "string": pa.string(),
    "wstring": pa.string(),
}  # fmt: skip
_BYTES = frozenset({"byte", "char", "uint8", "int8"})
_TIME, _DURATION = "builtin_interfaces/Time", "builtin_interfaces/Duration"
_UNIT = re.compile(r"\[([^\]]+)\]")
_STAMP = pa.timestamp("ns", "UTC")
#: Columns of every topic's table beside those of its messages.
COMMON = (
    pa.field("bag", pa.string(), metadata={"comment": "SHA-256 of the bag, first 16 digits"}),
    pa.field("received", _STAMP, metadata={"comment": "when the recorder had it"}),
    pa.field("published", _STAMP, metadata={"comment": "when it was sent"}),
)


def message_schema(type_name: str, definitions: Mapping[str, Definition]) -> pa.Schema:
    """Return the columns of a type's table.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/CellState".
        definitions: of the type and all that it contains (`definition.parse_definitions`).
    """
    own = next(iter(definitions.values()))
    return pa.schema([*COMMON, *_fields(own, definitions)], metadata={"type": type_name})


def message_row(message: Decoded) -> dict[str, object]:
    """Return a message's values by column, without those of `COMMON`."""
    return dict(_values(message))


def _fields(definition: Definition, definitions: Mapping[str, Definition]) -> Iterator[pa.Field]:
    for one in definition.fields:
        if one.count is not None and one.type_name in _BYTES and not one.enumeration:
            yield pa.field(f"{one.name}_length", pa.uint32(), metadata={"unit": "byte", **_metadata(one, unit=False)})
            continue
        kind = _kind(one.type_name, definitions)
        if one.count is not None:
            kind = pa.list_(kind)
        yield pa.field(one.name, kind, metadata=_metadata(one))
        if one.enumeration:
            name = pa.string() if one.count is None else pa.list_(pa.string())
            yield pa.field(f"{one.name}_name", name, metadata={"comment": f"constant of {one.name}"})


def _kind(type_name: str, definitions: Mapping[str, Definition]) -> pa.DataType:
    if type_name == _TIME:
        return _STAMP
    if type_name == _DURATION:
        return pa.duration("ns")
    if type_name in _ARROW:
        return _ARROW[type_name]
    fields = list(_fields(definitions[type_name], definitions))
    return pa.struct(fields or [pa.field("empty", pa.bool_())])


def _metadata(one: Field, *, unit: bool = True) -> dict[str, str]:
    found = _UNIT.match(one.comment)
    metadata = {"unit": found[1]} if found and unit else {}
    return metadata | ({"comment": one.comment} if one.comment else {})


def _values(message: Decoded) -> Iterator[tuple[str, object]]:
    for one in message.definition.fields:
        value = message.values[one.name]
        if one.count is not None and one.type_name in _BYTES and not one.enumeration:
            yield f"{one.name}_length", len(value)
            continue
        yield one.name, [_value(item) for item in value] if one.count is not None else _value(value)
        if one.enumeration:
            names = one.enumeration
            yield (
                f"{one.name}_name",
                [names.get(item, str(item)) for item in value]
                if one.count is not None
                else names.get(value, str(value)),
            )


def _value(value: object) -> object:
    if not isinstance(value, Decoded):
        return value
    if value.definition.name in {_TIME, _DURATION}:
        return value.values["sec"] * NANOSECONDS + value.values["nanosec"]
    return dict(_values(value)) or {"empty": True}
