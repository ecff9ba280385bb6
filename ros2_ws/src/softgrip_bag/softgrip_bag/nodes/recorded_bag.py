# SPDX-License-Identifier: Apache-2.0
"""A bag whose topics are looked through once, and whose messages have today's form.

What was recorded with an older definition is read by the definition that the bag carries, and written by name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from softgrip_bag import reader
from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.context import NodeSetUp, restore
from softgrip_bag.definition import Decoded, Definition, decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import is_installed, message_class
from softgrip_bag.old_definitions import ENUMERATIONS, READ_BY_NAME, UNSET, has_old_enumerations
from softgrip_bag.reader import RawMessage, TopicSummary, topic_summaries


class RecordedBag:
    """A bag, of one cell.

    Args:
        path: folder of the bag, or one .mcap file.

    Attributes:
        topics: all of them, by name.
        types: topic -> type.
        latched: topics whose every publisher offered transient-local durability.

    Raises:
        BagError: no bag, or no MCAP.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics = topic_summaries(path)
        self.types = {topic.name: topic.type_name for topic in self.topics}
        self.latched = {topic.name for topic in self.topics if topic.latched}

    @property
    def cell(self) -> str:
        """Namespace of the cell that was recorded, "" or "/cell_2"."""
        return cell_namespace(self.types)

    @property
    def is_before_unset(self) -> bool:
        """Whether its enumerations began with their first outcome."""
        return any(has_old_enumerations(topic.type_name, topic.schema) for topic in self.topics)

    def read(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages in order of reception, as `reader.read` does.

        Raises:
            BagError: bytes that are no message of the definition that the bag carries.
        """
        for raw in reader.read(self.path, topics):
            yield _renewed(raw, self._older[raw.topic]) if raw.topic in self._older else raw

    def check_definition(self, topic: TopicSummary) -> None:
        """Make sure that the messages of a topic can be read.

        Raises:
            BagError: the type is not installed, or is another one of that name and cannot be read by name.
        """
        if not is_installed(topic) and topic.name not in self._older:
            raise BagError(
                f"{topic.name}: expected {topic.type_name} as it is installed here, found one with other fields: the "
                "bag is of another ROS distribution or version; read it there, or by its schemas (rosbags, "
                "mcap-ros2-support)"
            )

    def check_definitions(self) -> None:
        """Make sure that all messages of softgrip can be read; see `check_definition`."""
        for topic in self.topics:
            if topic.type_name.startswith("softgrip_interfaces/") and topic.messages:
                self.check_definition(topic)

    def set_up(self, node: str, folder: Path) -> NodeSetUp:
        """Return what puts a node where it was, with the parameters and files that the bag carries.

        Args:
            node: its name, without namespace.
            folder: the files go there.
        """
        found = restore(self.path, f"{self.cell}/{node}", folder)
        place = ("-r", f"__ns:={self.cell}") if self.cell else ()
        return replace(found, arguments=(*place, *found.arguments))

    @cached_property
    def _older(self) -> Mapping[str, Mapping[str, Definition]]:
        """Topics that were recorded with an older definition that can be read by name."""
        return {
            topic.name: parse_definitions(topic.type_name, topic.schema)
            for topic in self.topics
            if _short_name(topic.type_name) in READ_BY_NAME and not is_installed(topic)
        }


def _short_name(type_name: str) -> str:
    package, _, name = type_name.partition("/")
    return f"{package}/{name.rpartition('/')[2]}"


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
