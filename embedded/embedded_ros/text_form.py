# SPDX-License-Identifier: Apache-2.0
"""Messages as YAML text and back, as the ``ros2`` command shows and takes them."""

from __future__ import annotations

import array
import functools
from typing import TYPE_CHECKING, Any

import yaml

from embedded_ros import arrays
from embedded_ros.cdr import ARRAY_CODES
from embedded_ros.errors import EmbeddedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from embedded_ros.interface_text import FieldType
    from embedded_ros.messages import Message


class FieldError(EmbeddedError):
    """A value that a field of a message cannot take."""


class _Truncated(str):
    """Text that YAML shows without quotes."""

    __slots__ = ()


class _Dumper(yaml.SafeDumper):
    pass


class _FlowDumper(_Dumper):
    """Lists in one line; messages in lines of their own all the same."""


_Dumper.add_representer(_Truncated, lambda dumper, value: dumper.represent_scalar("tag:yaml.org,2002:str", str(value)))
_FlowDumper.add_representer(
    dict, lambda dumper, value: dumper.represent_mapping("tag:yaml.org,2002:map", value.items(), flow_style=False)
)


def to_plain(
    message: Message, limit: int | None = None, *, arrays: bool = True, strings: bool = True
) -> dict[str, Any]:
    """Return a message as dicts, lists and scalars.

    Args:
        message: the message.
        limit: arrays and text longer than this are cut and end in ``...``; None for no limit.
        arrays: False shows arrays only by their type and length.
        strings: False shows text only by its type and length.
    """
    fields = message.DEFINITION.text.fields
    return {item.name: _plain(getattr(message, item.name), item.type, limit, arrays, strings) for item in fields}


def _plain(value: Any, kind: FieldType, limit: int | None, arrays: bool, strings: bool) -> Any:  # noqa: PLR0911
    if kind.array:
        if not arrays:
            return _array_info(value, kind)
        if kind.base == "byte":
            return [item[0] for item in value[:limit]] + (["..."] if limit is not None and len(value) > limit else [])
        items = [_plain(item, kind.element, limit, arrays, strings) for item in _cut(value, limit)]
        return items if limit is None or len(value) <= limit else [*items, "..."]
    if kind.text:
        if not strings:
            return f"<string length: <{len(value)}>>"
        return value if limit is None or len(value) <= limit else value[:limit] + "..."
    if kind.base == "byte":
        return value[0]
    if kind.primitive:
        return value
    return to_plain(value, limit, arrays=arrays, strings=strings)


def _array_info(value: Any, kind: FieldType) -> str:
    if kind.array == "fixed":
        return f"<array type: {kind.element}[{kind.size}]>"
    bound = f"[{kind.size}]" if kind.array == "bounded" else ""
    return f"<sequence type: {kind.element}{bound}, length: {len(value)}>"


def _cut(value: Any, limit: int | None) -> Any:
    part = value if limit is None else value[:limit]
    return part.tolist() if isinstance(part, array.array) or arrays.is_ndarray(part) else part


def to_yaml(
    message: Any, limit: int | None = None, *, arrays: bool = True, strings: bool = True, flow: bool = False
) -> str:
    """Return a message as YAML text that ends in a newline; anything else as itself."""
    if not hasattr(type(message), "DEFINITION"):
        return f"{message}\n" if not isinstance(message, list | tuple) else yaml.dump(message, Dumper=_Dumper)
    plain = to_plain(message, limit, arrays=arrays, strings=strings)
    dumper = _FlowDumper if flow else _Dumper
    return yaml.dump(plain, Dumper=dumper, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=10**9)


def parse_values(text: str) -> dict[str, Any]:
    """Read the YAML dictionary given on a command line."""
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FieldError(f"the passed value is not valid YAML: {error}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise FieldError("The passed value needs to be a dictionary in YAML format")
    return values


def fill(message: Message, values: dict[str, Any]) -> list[Callable[[Any], None]]:
    """Set fields from plain values; ``auto`` for a header and ``now`` for a time are set by what is returned.

    Returns:
        functions that take a time message.

    Raises:
        FieldError: an unknown field or a value of the wrong type.
    """
    stamps: list[Callable[[Any], None]] = []
    known = {item.name: item.type for item in message.DEFINITION.text.fields}
    for name, value in values.items():
        if name not in known:
            raise FieldError(f"{type(message).__name__} has no field '{name}'; it has: {', '.join(known) or 'none'}")
        kind = known[name]
        if kind.base == "std_msgs/msg/Header" and value == "auto":
            stamps.append(functools.partial(setattr, getattr(message, name), "stamp"))
        elif kind.base == "builtin_interfaces/msg/Time" and value == "now":
            stamps.append(functools.partial(setattr, message, name))
        else:
            try:
                setattr(message, name, _typed(value, kind, message, stamps))
            except (TypeError, ValueError, OverflowError) as error:
                raise FieldError(
                    f"{type(message).__name__}.{name}: expected {kind}, found {value!r} ({error})"
                ) from error
    return stamps


def _typed(  # noqa: PLR0911  one per kind of type
    value: Any, kind: FieldType, owner: Message, stamps: list[Callable[[Any], None]]
) -> Any:
    if kind.array:
        if not isinstance(value, list):
            raise TypeError(f"expected a list, found {type(value).__name__}")
        items = [_typed(item, kind.element, owner, stamps) for item in value]
        return (
            arrays.make_array(items, ARRAY_CODES[kind.base])
            if kind.array == "fixed" and kind.base in ARRAY_CODES
            else items
        )
    if not kind.primitive:
        if not isinstance(value, dict):
            raise TypeError(f"expected a dictionary, found {type(value).__name__}")
        nested = owner.DEFINITION.nested(kind.base)()
        stamps += fill(nested, value)
        return nested
    if kind.base in {"float32", "float64"}:
        return float(value)
    if kind.text:
        return str(value)
    if kind.base == "byte":
        return bytes([int(value)])
    if kind.base == "bool":
        if not isinstance(value, bool):
            raise TypeError("expected true or false")
        return value
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError("expected a whole number")
    return value
