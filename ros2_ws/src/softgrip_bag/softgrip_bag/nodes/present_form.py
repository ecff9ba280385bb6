# SPDX-License-Identifier: Apache-2.0
"""Give messages of older definitions today's form."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import yaml
from rclpy.serialization import serialize_message

from softgrip_bag.definition import Decoded, Definition, decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import message_class
from softgrip_bag.old_definitions import ENUMERATIONS, RESHAPED, UNSET, TraceAge, step_layouts


def renewed(type_name: str, definitions: Mapping[str, Definition], data: bytes, *, whole: bool = False) -> bytes:
    """Return a message, which older definitions describe, in the wire's form of today.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/FrictionModel".
        definitions: of it and all that it contains, as they were.
        data: as it was recorded.
        whole: the message has to be all of the bytes.

    Raises:
        BagError: the bytes are no such message.
    """
    old = decode(type_name, definitions, data, whole=whole)
    message = message_class(type_name)()
    try:
        _fill(message, old)
        return bytes(serialize_message(message))
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, yaml.YAMLError) as error:
        raise BagError(f"expected a {type_name} that has today's form, too, found {error!r}") from error


def renewed_step(name: str, data: bytes, age: TraceAge) -> bytes:
    """Return the data of a step of a trace in the wire's form of today.

    Raises:
        BagError: the bytes fit no definition of that time.
    """
    type_name, layouts = step_layouts(name, age)
    problem: BagError | None = None
    for layout in layouts:
        try:
            return renewed(type_name, parse_definitions(type_name, layout), data, whole=True)
        except BagError as error:
            problem = error
    if problem is not None:
        raise problem
    return data


def _fill(message: Any, old: Decoded) -> None:
    """Copy the fields that both have, and those that an old one became."""
    enumerations = ENUMERATIONS.get(old.definition.name, {})
    values = dict(old.values)
    if old.definition.name in RESHAPED:
        values |= RESHAPED[old.definition.name](values)
    for name, kind in message.get_fields_and_field_types().items():
        if name not in values:
            continue
        value = values[name]
        if name in enumerations:
            value = _by_name(type(message), old.definition, enumerations[name], value)
        elif isinstance(value, Decoded):
            _fill(getattr(message, name), value)
            continue
        elif isinstance(value, list) and value and isinstance(value[0], Decoded):
            value = [_filled(kind, element) for element in value]
        setattr(message, name, _as_field(getattr(message, name), value))


def _by_name(kind: type[object], definition: Definition, names: Collection[str], value: int | str) -> int:
    """Return today's number of the name that a number had then, or of a name; 0, which is unset, where it had none."""
    if isinstance(value, str):
        found = value.upper() if value.upper() in names else UNSET
    else:
        found = next((name for name in names if definition.constants.get(name) == value), UNSET)
    return 0 if found == UNSET else int(getattr(kind, found))


def _filled(kind: str, old: Decoded) -> Any:
    """Return a new element of "sequence<package/Name>"."""
    package, name = kind.removeprefix("sequence<").rstrip(">").split("[")[0].split(",")[0].split("/")
    element = message_class(f"{package}/msg/{name}")()
    _fill(element, old)
    return element


def _as_field(present: object, value: object) -> object:
    """Return a value as the field wants it: one byte for `byte`, what is there already decides for arrays."""
    if isinstance(present, bytes) and isinstance(value, int):
        return bytes([value])
    return value
