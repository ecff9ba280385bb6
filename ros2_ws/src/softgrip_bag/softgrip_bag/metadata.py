# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml of a bag, version 9, as rosbag2 of ROS 2 Jazzy writes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from softgrip_model.durable import write_durably

try:
    from yaml import CSafeDumper as SafeDumper
except ImportError:  # PyYAML without libyaml
    from yaml import SafeDumper  # type: ignore[assignment]

VERSION = 9
DISTRIBUTION = "jazzy"
FILE_NAME = "metadata.yaml"


class Plain(SafeDumper):
    """YAML without anchors: rosbag2's files have none."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  the name is PyYAML's
        """Write every value out."""
        return True


@dataclass
class Span:
    """What a file covers: times of reception [ns] and number of messages."""

    first: int | None = None
    last: int = 0
    messages: int = 0

    def add(self, received: int) -> None:
        """Count one message."""
        self.first = received if self.first is None else min(self.first, received)
        self.last = max(self.last, received)
        self.messages += 1

    def as_map(self) -> dict[str, object]:
        """Return rosbag2's three entries."""
        start = self.first or 0
        return {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": self.last - start if self.messages else 0},
            "message_count": self.messages,
        }


@dataclass
class TopicEntry:
    """A topic in the metadata; ``qos`` are rosbag2's maps."""

    name: str
    type_name: str
    type_hash: str
    qos: Sequence[dict[str, object]]
    messages: int = 0


@dataclass
class FileEntry:
    """A file of the bag."""

    name: str
    span: Span = field(default_factory=Span)


def information(files: Sequence[FileEntry], topics: Sequence[TopicEntry]) -> dict[str, object]:
    """Return the metadata of a bag as plain maps, without rosbag2's outer key."""
    whole = Span()
    for file in files:
        if file.span.first is not None:
            whole.first = file.span.first if whole.first is None else min(whole.first, file.span.first)
        whole.last = max(whole.last, file.span.last)
        whole.messages += file.span.messages
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **whole.as_map(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": list(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.messages,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **file.span.as_map()} for file in files],
        "custom_data": {},
        "ros_distro": DISTRIBUTION,
    }


def write(folder: Path, values: dict[str, object]) -> None:
    """Write metadata.yaml into a bag's folder; complete or not at all, also when the power dies.

    Raises:
        OSError: the disk refused.
    """
    text = yaml.dump({"rosbag2_bagfile_information": values}, Dumper=Plain, sort_keys=False)
    write_durably(folder / FILE_NAME, text.encode())
