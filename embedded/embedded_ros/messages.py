# SPDX-License-Identifier: Apache-2.0
"""Makes Python classes from interface text, with the semantics of rosidl's generated ones."""

from __future__ import annotations

import array
import copy
import functools
import os
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from embedded_ros import arrays, cdr, field_check, type_hash
from embedded_ros.cdr import ARRAY_CODES
from embedded_ros.errors import UnknownInterfaceError
from embedded_ros.interface_text import Field, FieldType, MessageText, parse_interface

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_T = TypeVar("_T", bound="Message")
KINDS = ("msg", "srv", "action")
_ZERO = {"bool": False, "byte": b"\0", "float32": 0.0, "float64": 0.0, "string": "", "wstring": ""}


def checks_fields() -> bool:
    """Whether assignments are checked too, as ROS_PYTHON_CHECK_FIELDS=1 asks rosidl's classes to do."""
    return os.environ.get("ROS_PYTHON_CHECK_FIELDS", "") == "1"


class Definition:
    """What is known about an interface: its text, and what is made from it on first use."""

    def __init__(self, text: MessageText, lookup: Callable[[str], type[Message]]) -> None:
        self.text = text
        self.nested = lookup

    @functools.cached_property
    def type_hash(self) -> str:
        """The RIHS01 hash."""
        return type_hash.type_hash(self.text, lambda name: self.nested(name).DEFINITION.text)

    @property
    def description(self) -> dict[str, Any]:
        """The REP-2016 description of the type and of all it refers to."""
        return type_hash.full_description(self.text, lambda name: self.nested(name).DEFINITION.text)


class MessageDefinition(Definition):
    """A definition with the class it belongs to."""

    message: type[Message]

    @functools.cached_property
    def defaults(self) -> list[tuple[str, Callable[[], object]]]:
        """Field names with what makes their default values."""
        return [(field.name, _default_factory(field, self)) for field in self.text.fields]

    @functools.cached_property
    def serialize(self) -> Callable[[Any], bytearray]:
        """Writes the CDR of a message."""
        return cdr.make_serializer(self.message)

    @functools.cached_property
    def deserialize(self) -> Callable[[bytes], Any]:
        """Reads the CDR of a message."""
        return cdr.make_deserializer(self.message)


class _Constants(type):
    """Metaclass of messages: constants and defaults are read-only class attributes."""

    def __setattr__(cls, name: str, value: object) -> None:
        if name in cls.__dict__.get("CONSTANTS", {}):
            raise AttributeError(f"{cls.__name__}.{name} is a constant")
        super().__setattr__(name, value)


class Message(metaclass=_Constants):
    """Base of all message classes; subclasses are made by :func:`make_message`.

    Its own class attributes are in capitals, so that no field can have the same name.
    """

    __slots__ = ("_check_fields",)
    DEFINITION: ClassVar[MessageDefinition]
    CONSTANTS: ClassVar[dict[str, object]] = {}
    SLOT_TYPES: ClassVar[tuple[FieldType, ...]] = ()
    _fields_and_field_types: ClassVar[dict[str, str]] = {}

    def __init__(self, **kwargs: object) -> None:
        for name, make in self.DEFINITION.defaults:
            if name in kwargs:
                setattr(self, name, kwargs.pop(name))
            else:
                setattr(self, "_" + name, make())
        if kwargs:
            expected = ", ".join(self._fields_and_field_types)
            raise AssertionError(
                f"Invalid arguments passed to constructor: {', '.join(sorted(kwargs))}; fields are {expected}"
            )

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return field names with their types as text."""
        return copy.copy(cls._fields_and_field_types)

    def __eq__(self, other: object) -> bool:
        if other.__class__ is not self.__class__:
            return False if isinstance(other, Message) else NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in self._fields_and_field_types)

    __hash__ = None  # type: ignore[assignment]  # mutable values, as in rosidl

    def __repr__(self) -> str:
        def text(value: object) -> str:
            return repr(value.tolist()) if isinstance(value, array.array) else repr(value)

        package, kind, _ = self.DEFINITION.text.name.split("/")
        fields = ", ".join(f"{name}={text(getattr(self, name))}" for name in self._fields_and_field_types)
        return f"{package}.{kind}.{type(self).__name__}({fields})"

    def __copy__(self) -> Self:
        twin: Self = object.__new__(type(self))
        for name in self._fields_and_field_types:
            setattr(twin, "_" + name, getattr(self, name))
        return twin

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        twin: Self = object.__new__(type(self))
        for name in self._fields_and_field_types:
            setattr(twin, "_" + name, copy.deepcopy(getattr(self, name), memo))
        return twin

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (self.DEFINITION.text.name, bytes(serialize(self)))


def _rebuild(name: str, data: bytes) -> Message:
    from embedded_ros.registry import registry  # noqa: PLC0415  only unpickling needs it

    return deserialize(data, registry().message(name))


def serialize(message: Message) -> bytearray:
    """Return the CDR of a message with its 4-byte header.

    Raises:
        TypeError, ValueError: a field holds what ROS 2 would abort the process for; names field, expected and found.
    """
    try:
        return message.DEFINITION.serialize(message)
    except Exception:
        field_check.explain(message)
        raise


def deserialize(data: bytes, kind: type[_T]) -> _T:
    """Return the message of class ``kind`` that ``data`` (CDR with header) holds."""
    result: _T = kind.DEFINITION.deserialize(data)
    return result


def _default_factory(field: Field, owner: Definition) -> Callable[[], object]:  # noqa: PLR0911  one per kind of field
    kind, default = field.type, field.default
    if kind.array and kind.base in ARRAY_CODES:
        code = ARRAY_CODES[kind.base]
        if kind.array == "fixed":
            return arrays.make_array([0] * kind.size if default is None else default, code).copy
        start: array.array[Any] = array.array(code, list(default) if isinstance(default, list) else [])
        return lambda: start[:]
    if kind.array:
        if default is not None:
            return lambda: list(default)  # type: ignore[call-overload]
        if kind.array != "fixed":
            return list
        make = _default_factory(Field(field.name, kind.element), owner)
        return lambda: [make() for _ in range(kind.size)]
    if kind.primitive:
        value = _ZERO.get(kind.base, 0) if default is None else default
        return lambda: value
    return owner.nested(kind.base)


def _property(field: Field) -> property:
    """Return the property of a field that needs conversion or a check on assignment."""
    slot, kind = "_" + field.name, field.type
    code = ARRAY_CODES.get(kind.base, "") if kind.array else ""
    checked = checks_fields()

    def get(self: Message) -> object:
        value = getattr(self, slot)
        if value.__class__ is memoryview:
            value = array.array(code, value.tobytes())
            setattr(self, slot, value)
        return value

    def put(self: Message, value: Any) -> None:
        if checked:
            field_check.check_assignment(self, field, value)
        if code and kind.array == "fixed":
            value = arrays.make_array(value, code)
        elif code and not (isinstance(value, array.array) and value.typecode == code):
            value = array.array(code, value.tobytes() if arrays.is_ndarray(value, code) else value)
        setattr(self, slot, value)

    return property(get, put, doc=f"Field '{field.name}' of type {kind}.")


def _equal(one: Any, other: Any) -> bool:
    if arrays.is_ndarray(one) or arrays.is_ndarray(other):
        return len(one) == len(other) and bool((one == other).all())
    return bool(one == other)


def make_message(text: MessageText, lookup: Callable[[str], type[Message]]) -> type[Message]:
    """Make the class of a parsed message.

    Args:
        text: the parsed definition.
        lookup: gives the class of ``pkg/msg/Name``; asked when the class is first used, so order does not matter.
    """
    package, kind, name = text.name.split("/")
    constants = {constant: value for constant, _, value in text.constants}
    for field in text.fields:
        if field.default is not None:
            constants[f"{field.name.upper()}__DEFAULT"] = field.default
    body: dict[str, Any] = {
        "__slots__": tuple("_" + field.name for field in text.fields),
        "__module__": f"{package}.{kind}",
        "__qualname__": name,
        "__doc__": f"{text.name}.",
        "DEFINITION": MessageDefinition(text, lookup),
        "CONSTANTS": {},
        "_fields_and_field_types": {field.name: str(field.type) for field in text.fields},
        "SLOT_TYPES": tuple(field.type for field in text.fields),
        **constants,
    }
    made: Any = _Constants(name, (Message,), body)
    for field in text.fields:
        plain = not (field.type.array and field.type.base in ARRAY_CODES) and not checks_fields()
        # A plain field is the slot itself under its public name: no Python code runs on access.
        setattr(made, field.name, made.__dict__["_" + field.name] if plain else _property(field))
    made.DEFINITION.message = made
    made.CONSTANTS = constants
    result: type[Message] = made
    return result


def parse_file(path: Path, package: str, kind: str) -> list[MessageText]:
    """Parse a file; a missing one is an unknown interface."""
    if not path.is_file():
        raise UnknownInterfaceError(f"{package}/{kind}/{path.stem} is not defined: expected the file {path}")
    return parse_interface(path, package, kind)
