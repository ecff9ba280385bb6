# SPDX-License-Identifier: Apache-2.0
"""A bag on disk: an MCAP file of raw CDR with everything needed to read it, and rosbag2's metadata.yaml beside it.

What was written is readable at the latest `FLUSH_INTERVAL` later, whatever happens to the process: chunks are
closed and handed to the disk by time as well as by size.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer

from softgrip_bag.errors import BagError
from softgrip_bag.qos_text import OfferedQos

#: [s] longest time a message waits in memory.
FLUSH_INTERVAL = 0.25
CHUNK_BYTES = 1 << 20
METADATA_VERSION = 9
DISTRIBUTION = "jazzy"


class _Plain(yaml.SafeDumper):
    """YAML without anchors: rosbag2's files have none."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002  the name is PyYAML's
        """Write every value out."""
        return True


@dataclass
class Topic:
    """One recorded topic."""

    name: str
    type_name: str  # e.g. "sensor_msgs/msg/JointState"
    type_hash: str  # RIHS01_...
    schema: str  # ros2msg text
    qos: tuple[OfferedQos, ...]
    channel: int = 0
    messages: int = 0


@dataclass
class _Span:
    first: int | None = None
    last: int = 0
    messages: int = 0

    def add(self, stamp: int) -> None:
        self.first = stamp if self.first is None else min(self.first, stamp)
        self.last = max(self.last, stamp)
        self.messages += 1


@dataclass
class BagWriter:
    """Writes one bag; not thread-safe.

    Args:
        folder: to be created; must not exist.
        facts: metadata records, name -> {key: value}, written at the start.
    """

    folder: Path
    facts: dict[str, dict[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(
                f"expected a new folder for the bag, found that {self.folder} exists: name another"
            ) from None
        except OSError as error:
            raise BagError(f"cannot create the bag's folder {self.folder}: {error.strerror}") from error
        self.topics: dict[str, Topic] = {}
        self._schemas: dict[str, int] = {}
        self._span = _Span()
        self._path = self.folder / f"{self.folder.name}_0.mcap"
        self._file = self._path.open("wb")
        self._mcap = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._mcap.start(profile="ros2", library="softgrip_bag")
        for name, facts in self.facts.items():
            self._mcap.add_metadata(name, facts)
        self._flushed = time.monotonic()

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return self._span.messages

    def add_topic(self, topic: Topic) -> None:
        """Register a topic; once per name."""
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._mcap.register_schema(
                topic.type_name, "ros2msg", topic.schema.encode()
            )
        qos = yaml.dump([offered.as_map() for offered in topic.qos], Dumper=_Plain, sort_keys=False)
        topic.channel = self._mcap.register_channel(
            topic.name,
            "cdr",
            self._schemas[topic.type_name],
            {"offered_qos_profiles": qos, "topic_type_hash": topic.type_hash},
        )
        self.topics[topic.name] = topic

    def write(self, topic: str, received: int, published: int, data: bytes) -> None:
        """Write one message; ``received`` and ``published`` [ns since the epoch], ``data`` CDR with its header."""
        entry = self.topics[topic]
        self._mcap.add_message(entry.channel, received, data, published, 0)
        entry.messages += 1
        self._span.add(received)

    def flush_if_due(self) -> None:
        """Hand what is in memory to the disk when the flush interval has passed."""
        now = time.monotonic()
        if now - self._flushed >= FLUSH_INTERVAL:
            self._flushed = now
            self._mcap.flush()  # type: ignore[no-untyped-call]  # the library has no types
            os.fdatasync(self._file.fileno())

    def close(self) -> Path:
        """Finish the file and write metadata.yaml; returns the bag's folder."""
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": yaml.dump(self._information(), Dumper=_Plain)})
        self._mcap.finish()  # type: ignore[no-untyped-call]  # the library has no types
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        text = yaml.dump({"rosbag2_bagfile_information": self._information()}, Dumper=_Plain, sort_keys=False)
        (self.folder / "metadata.yaml").write_text(text)
        return self.folder

    def _information(self) -> dict[str, Any]:
        start = self._span.first or 0
        times = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": self._span.last - start if self._span.messages else 0},
            "message_count": self._span.messages,
        }
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **times,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [offered.as_map() for offered in topic.qos],
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": topic.messages,
                }
                for topic in self.topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._path.name],
            "files": [{"path": self._path.name, **times}],
            "custom_data": {},
            "ros_distro": DISTRIBUTION,
        }
