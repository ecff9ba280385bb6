# SPDX-License-Identifier: Apache-2.0
"""Says which field of a message is wrong, what was expected and what was found."""

from __future__ import annotations

import array
from typing import TYPE_CHECKING, Any

from embedded_ros import arrays
from embedded_ros.cdr import ARRAY_CODES
from embedded_ros.interface_text import INTEGER_RANGES, Field, FieldType

if TYPE_CHECKING:
    from embedded_ros.messages import Message

FLOAT32_MAX = 3.4028234663852886e38


def explain(message: Message, path: str = "") -> None:
    """Raise TypeError or ValueError for the first field whose value ROS 2 would not take; return when all are fine."""
    label = path or type(message).__name__
    for field in message.DEFINITION.text.fields:
        if not hasattr(message, "_" + field.name):
            raise TypeError(f"{label}.{field.name}: never set")
        _check(field.type, getattr(message, field.name), f"{label}.{field.name}", message)


def check_assignment(message: Message, field: Field, value: object) -> None:
    """Check a value before it is assigned; AssertionError, as rosidl's classes raise with checks on."""
    kind = field.type
    try:
        if kind.array and kind.base in ARRAY_CODES and not (isinstance(value, array.array) or arrays.is_ndarray(value)):
            _check_items(kind, value, field.name, message)
        else:
            _check(kind, value, field.name, message)
    except (TypeError, ValueError) as error:
        raise AssertionError(f"The '{field.name}' field of {type(message).__name__}: {error}") from error


def _wrong(where: str, expected: str, value: object) -> TypeError:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return TypeError(f"{where}: expected {expected}, found {type(value).__module__}.{type(value).__name__} {shown}")


def _check(kind: FieldType, value: Any, where: str, owner: Message) -> None:
    if not kind.array:
        _check_element(kind, value, where, owner)
        return
    if kind.base in ARRAY_CODES:
        code = ARRAY_CODES[kind.base]
        if kind.array == "fixed":
            if not arrays.is_ndarray(value, code):
                raise _wrong(where, f"a numpy.ndarray of dtype {arrays.dtype(code)} and size {kind.size}", value)
        elif not isinstance(value, array.array) or value.typecode != code:
            raise _wrong(where, f"array.array({code!r})", value)
        _check_length(kind, value, where)
        return
    _check_items(kind, value, where, owner)


def _check_length(kind: FieldType, value: Any, where: str) -> None:
    if kind.array == "fixed" and len(value) != kind.size:
        raise ValueError(f"{where}: expected {kind.size} elements, found {len(value)}")
    if kind.array == "bounded" and len(value) > kind.size:
        raise ValueError(f"{where}: expected at most {kind.size} elements, found {len(value)}")


def _check_items(kind: FieldType, value: Any, where: str, owner: Message) -> None:
    if isinstance(value, str | bytes) or not (hasattr(value, "__len__") and hasattr(value, "__iter__")):
        raise _wrong(where, f"a sequence of {kind.element}", value)
    _check_length(kind, value, where)
    for i, item in enumerate(value):
        _check_element(kind.element, item, f"{where}[{i}]", owner)


def _check_element(kind: FieldType, value: Any, where: str, owner: Message) -> None:
    if kind.text:
        _check_text(kind, value, where)
    elif kind.base == "byte":
        if not (isinstance(value, bytes) and len(value) == 1):
            raise _wrong(where, "bytes of length 1", value)
    elif kind.primitive:
        _check_number(kind.base, value, where)
    elif not isinstance(value, owner.DEFINITION.nested(kind.base)):
        raise _wrong(where, kind.base, value)
    else:
        explain(value, where)


def _check_number(base: str, value: Any, where: str) -> None:
    expected = {"float32": float, "float64": float, "bool": bool}.get(base, int)
    if not isinstance(value, expected):
        raise _wrong(where, expected.__name__, value)
    if base == "float32" and FLOAT32_MAX < abs(value) < float("inf"):
        raise ValueError(f"{where}: expected a float32 (at most {FLOAT32_MAX:g}), found {value!r}")
    if expected is int:
        low, high = INTEGER_RANGES["uint8" if base == "char" else base]
        if not low <= value <= high:
            raise ValueError(f"{where}: expected {base} in [{low}, {high}], found {value}")


def _check_text(kind: FieldType, value: Any, where: str) -> None:
    if not isinstance(value, str):
        raise _wrong(where, "str", value)
    if kind.text_bound and len(value) > kind.text_bound:
        raise ValueError(f"{where}: expected at most {kind.text_bound} characters, found {len(value)}")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{where}: expected text that UTF-8 can hold, found {value!r} ({error.reason})") from None
