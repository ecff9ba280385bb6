# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag: their classes and definitions, their stamps, and what they say as plain values."""

from __future__ import annotations

import functools
import importlib
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.serialization import deserialize_message

from softgrip_bag.errors import BagError
from softgrip_bag.reader import TopicSummary
from softgrip_bag.schema_text import same_definition, schema_text
from softgrip_nodekit import nanoseconds
from softgrip_time.units import NANOSECONDS

#: Bytes of CDR before the message; the second one says whether it is little endian.
_ENCAPSULATION = 4
_STAMP = (struct.Struct(">iI"), struct.Struct("<iI"))
#: Longer arrays (images, meshes) are no table columns; their length is.
_COLUMNS = 64


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the class of e.g. "std_msgs/msg/String", "pkg/action/Move_Result" or "pkg/srv/Set_Event".

    Raises:
        BagError: when the package is not installed or does not have the type.
    """
    package, kind, name = type_name.split("/")
    try:
        whole, _, part = name.partition("_")  # the name of an interface has no underscore
        found = getattr(importlib.import_module(f"{package}.{kind}"), whole)
        if part == "FeedbackMessage":
            return found.Impl.FeedbackMessage
        return getattr(found, part) if part else found
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


def is_installed(topic: TopicSummary) -> bool:
    """Return whether a topic was recorded with the definition that is installed here.

    Raises:
        BagError: the type is not installed.
    """
    message_class(topic.type_name)
    return not topic.schema or same_definition(topic.schema, schema_text(topic.type_name, interface_text))


def stamp_of(message: Any) -> int:
    """Return header.stamp [ns]."""
    return nanoseconds(message.header.stamp)


def stamp_in(data: bytes, kind: object) -> int:
    """Return header.stamp [ns] of a message in the wire's form; where the header comes first nothing else is read."""
    if not _begins_with_header(kind):
        return stamp_of(deserialize_message(data, kind))
    seconds, nanoseconds = _STAMP[data[1] & 1].unpack_from(data, _ENCAPSULATION)
    return int(seconds) * NANOSECONDS + int(nanoseconds)


@functools.cache
def _begins_with_header(kind: Any) -> bool:
    return next(iter(kind.get_fields_and_field_types().items()), None) == ("header", "std_msgs/Header")


def tree(message: object) -> Any:
    """Return a message as nested dicts and lists of plain values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: tree(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)):
        return [tree(item) for item in message]
    return message


def flat(value: object, path: str = "") -> Iterator[tuple[str, object]]:
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
