# SPDX-License-Identifier: Apache-2.0
"""A bag whose topics are looked through once, and whose messages have today's form."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.context import recorded_parameters, restore
from softgrip_bag.nodes.messages import check_definition, is_older, read
from softgrip_bag.old_definitions import has_old_enumerations
from softgrip_bag.reader import RawMessage, topic_summaries


class RecordedBag:
    """A bag of one cell.

    Args:
        path: folder of the bag, or one .mcap file.

    Attributes:
        types: topic -> type.
        latched: topics whose every publisher offered transient-local durability.
        cell: namespace of the cell that was recorded, "" or "/cell_2".
        is_before_unset: whether its enumerations began with their first outcome.

    Raises:
        BagError: no bag, or no MCAP.
    """

    def __init__(self, path: Path) -> None:
        self._topics = topics = topic_summaries(path)
        self.path = path
        self.types = {topic.name: topic.type_name for topic in topics}
        self.latched = {topic.name for topic in topics if topic.latched}
        self.cell = cell_namespace(self.types)
        self.is_before_unset = any(has_old_enumerations(topic.type_name, topic.schema) for topic in topics)

    def check_definitions(self) -> None:
        """Make sure that all messages of softgrip can be read.

        Raises:
            BagError: a definition is another one than what is installed, and cannot be read by name.
        """
        for topic in self._topics:
            if topic.type_name.startswith("softgrip_interfaces/") and topic.messages and not is_older(topic):
                check_definition(topic)

    def read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield messages in order of reception."""
        return read(self.path, topics)

    def parameters(self, node: str) -> Mapping[str, Any]:
        """Return what a node's parameters were set to; empty when the bag does not carry them."""
        return recorded_parameters(self.path, f"{self.cell}/{node}")

    def set_up(self, node: str, folder: Path) -> list[str]:
        """Return ROS arguments that put a node where it was, with the parameters and files that the bag carries.

        Args:
            node: its name, without namespace.
            folder: the files go there.
        """
        place = ["-r", f"__ns:={self.cell}"] if self.cell else []
        return [*place, *restore(self.path, f"{self.cell}/{node}", folder)]
