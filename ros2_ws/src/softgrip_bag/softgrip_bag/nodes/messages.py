# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag: their classes, their bytes in today's form, their stamps, and what they say as plain values.

What was recorded with an older definition is read by the definition that the bag carries, and written by name.
"""

from __future__ import annotations

import functools
import importlib
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag import reader
from softgrip_bag.definition import Decoded, Definition, decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.old_definitions import ENUMERATIONS, READ_BY_NAME, UNSET
from softgrip_bag.reader import RawMessage, TopicSummary, topic_summaries
from softgrip_bag.schema_text import same_definition, schema_text
from softgrip_nodekit import nanoseconds

#: Bytes of CDR before the message; the second one says whether it is little endian.
_ENCAPSULATION = 4
_STAMP = (struct.Struct(">iI"), struct.Struct("<iI"))
#: Longer arrays (images, meshes) are no table columns; their length is.
_COLUMNS = 64


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the class of e.g. "std_msgs/msg/String" "pkg/action/Move_FeedbackMessage" or "pkg/srv/Set_Event".

    Raises:
        BagError: when the package is not installed or does not have the type.
    """
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind == "action" and name.endswith("_FeedbackMessage"):
            return getattr(module, name.removesuffix("_FeedbackMessage")).Impl.FeedbackMessage
        if kind == "srv" and name.endswith("_Event"):
            return getattr(module, name.removesuffix("_Event")).Event
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise BagError(
            f"expected an installed type {type_name}, found none ({error}); install package {package}"
        ) from error


def interface_text(package: str, kind: str, name: str) -> str:
    """Return the definition of an interface from its package's share folder."""
    try:
        path = Path(get_package_share_directory(package)) / kind / f"{name}.{kind}"
        return path.read_text()
    except (PackageNotFoundError, OSError) as error:
        raise BagError(f"expected the definition of {package}/{kind}/{name}, found none ({error})") from error


def check_definition(topic: TopicSummary) -> None:
    """Make sure that a topic was recorded with the definition that is installed here.

    Raises:
        BagError: when the type is not installed, or is another one of that name.
    """
    message_class(topic.type_name)
    if topic.schema and not same_definition(topic.schema, schema_text(topic.type_name, interface_text)):
        raise BagError(
            f"{topic.name}: expected {topic.type_name} as it is installed here, found one with other fields: the bag "
            "is of another ROS distribution or version; read it there, or by its schemas (rosbags, mcap-ros2-support)"
        )


def read(bag: Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield the messages of a bag as `reader.read` does, those of older definitions in today's form.

    Raises:
        BagError: no bag, or bytes that are no message of the definition that the bag carries.
    """
    old = {topic.name: _definitions(topic) for topic in topic_summaries(bag) if is_older(topic)}
    for raw in reader.read(bag, topics):
        yield _renewed(raw, old[raw.topic]) if raw.topic in old else raw


def is_older(topic: TopicSummary) -> bool:
    """Return whether a topic was recorded with an older definition that can be read by name."""
    package, _, name = topic.type_name.partition("/")
    short = f"{package}/{name.rpartition('/')[2]}"
    return short in READ_BY_NAME and not _is_installed(topic)


def _is_installed(topic: TopicSummary) -> bool:
    return not topic.schema or same_definition(topic.schema, schema_text(topic.type_name, interface_text))


def _definitions(topic: TopicSummary) -> Mapping[str, Definition]:
    return parse_definitions(topic.type_name, topic.schema)


def _renewed(raw: RawMessage, definitions: Mapping[str, Definition]) -> RawMessage:
    message = message_class(raw.type_name)()
    _fill(message, decode(raw.type_name, definitions, raw.data))
    return replace(raw, data=bytes(serialize_message(message)))


def _fill(message: Any, old: Decoded) -> None:
    """Copy the fields that both have."""
    enumerations = ENUMERATIONS.get(old.definition.name, {})
    for name, kind in message.get_fields_and_field_types().items():
        if name not in old.values:
            continue
        value = old.values[name]
        if name in enumerations:
            value = _by_name(type(message), old.definition, enumerations[name], value)
        elif isinstance(value, Decoded):
            _fill(getattr(message, name), value)
            continue
        elif isinstance(value, list) and value and isinstance(value[0], Decoded):
            value = [_filled(kind, element) for element in value]
        setattr(message, name, _as_field(getattr(message, name), value))


def _by_name(kind: Any, definition: Definition, names: Collection[str], value: int) -> int:
    """Return today's number of the name that a number had then; UNSET's where it had none."""
    found = next((name for name in names if definition.constants.get(name) == value), UNSET)
    return int(getattr(kind, found))


def _filled(kind: str, old: Decoded) -> Any:
    """Return a new element of "sequence<package/Name>"."""
    package, name = kind.removeprefix("sequence<").rstrip(">").split("[")[0].split(",")[0].split("/")
    element = message_class(f"{package}/msg/{name}")()
    _fill(element, old)
    return element


def _as_field(present: Any, value: Any) -> Any:
    """Return a value as the field wants it: one byte for `byte`, what is there already decides for arrays."""
    if isinstance(present, bytes) and isinstance(value, int):
        return bytes([value])
    return value


def stamp_of(message: Any) -> int:
    """Return header.stamp [ns]."""
    return nanoseconds(message.header.stamp)


def stamp_in(data: bytes, kind: Any) -> int:
    """Return header.stamp [ns] of a message in the wire's form; where the header comes first nothing else is read."""
    if not _begins_with_header(kind):
        return stamp_of(deserialize_message(data, kind))
    seconds, nanoseconds = _STAMP[data[1] & 1].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


@functools.cache
def _begins_with_header(kind: Any) -> bool:
    return next(iter(kind.get_fields_and_field_types().items()), None) == ("header", "std_msgs/Header")


def tree(message: Any) -> Any:
    """Return a message as nested dicts and lists of plain values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: tree(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)):
        return [tree(item) for item in message]
    return message


def flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (column, value) of every leaf of a tree: ``fingers.0.tip.x``."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from flat(item, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and value and not isinstance(value[0], int | float | str | bytes | bool):
        for index, item in enumerate(value):
            yield from flat(item, f"{path}.{index}")
    elif isinstance(value, list) and len(value) <= _COLUMNS:
        for index, item in enumerate(value):
            yield f"{path}.{index}", item
    elif isinstance(value, (list, bytes)):
        yield f"{path}.length", len(value)
    else:
        yield path, value
