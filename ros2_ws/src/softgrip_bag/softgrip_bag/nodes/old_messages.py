# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag in today's form: what was recorded with an older definition is read by it and written by name."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from softgrip_bag import reader
from softgrip_bag.definition import Decoded, Definition, decode, parse_definitions
from softgrip_bag.nodes.types import interface_text, message_class
from softgrip_bag.old_definitions import ENUMERATIONS, READ_BY_NAME, UNSET, has_old_enumerations
from softgrip_bag.reader import RawMessage, TopicSummary, topic_summaries
from softgrip_bag.schema_text import same_definition, schema_text


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


def is_before_unset(bag: Path) -> bool:
    """Return whether a bag was recorded when enumerations began with their first outcome."""
    return any(has_old_enumerations(topic.type_name, topic.schema) for topic in topic_summaries(bag))


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
