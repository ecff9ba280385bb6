# SPDX-License-Identifier: Apache-2.0
"""A bag whose topics are looked through once, and whose messages have today's form.

What was recorded with an older definition is read by the definition that the bag carries, and written by name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from softgrip_bag import reader
from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.context import NodeSetUp, restore
from softgrip_bag.definition import Definition, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.messages import is_installed
from softgrip_bag.nodes.present_form import renewed
from softgrip_bag.old_definitions import READ_BY_NAME, TraceAge, has_old_enumerations, has_worded_swaps
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

    def age_of_trace(self, topic: str) -> TraceAge:
        """Return what the steps of a node's trace can hold: no bag carries the definitions of their data."""
        had_columns = topic in self.older
        had_worded_swaps = had_columns or any(has_worded_swaps(one.type_name, one.schema) for one in self.topics)
        return TraceAge(had_columns, had_worded_swaps, self.is_before_unset)

    def read(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages in order of reception, as `reader.read` does.

        Raises:
            BagError: bytes that are no message of the definition that the bag carries.
        """
        for raw in reader.read(self.path, topics):
            if raw.topic in self.older:
                yield replace(raw, data=renewed(raw.type_name, self.older[raw.topic], raw.data))
            else:
                yield raw

    def check_definition(self, topic: TopicSummary) -> None:
        """Make sure that the messages of a topic can be read.

        Raises:
            BagError: the type is not installed, or is another one of that name and cannot be read by name.
        """
        if not is_installed(topic) and topic.name not in self.older:
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
    def older(self) -> Mapping[str, Mapping[str, Definition]]:
        """Topics that were recorded with an older definition that can be read by name."""
        return {
            topic.name: parse_definitions(topic.type_name, topic.schema)
            for topic in self.topics
            if _short_name(topic.type_name) in READ_BY_NAME and not is_installed(topic)
        }


def _short_name(type_name: str) -> str:
    package, _, name = type_name.partition("/")
    return f"{package}/{name.rpartition('/')[2]}"
