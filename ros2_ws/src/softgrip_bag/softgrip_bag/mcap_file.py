# SPDX-License-Identifier: Apache-2.0
"""One MCAP file being written: whole chunks go to the disk, and the end of the last whole one is known."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import yaml

from softgrip_bag.mcap_stream import McapStream
from softgrip_bag.metadata import Plain, Span
from softgrip_bag.qos_text import OfferedQos

CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class Topic:
    """A topic to record."""

    name: str
    type_name: str  # e.g. "sensor_msgs/msg/JointState"
    type_hash: str  # RIHS01_...
    schema: str  # ros2msg text
    qos: tuple[OfferedQos, ...]

    @property
    def latched(self) -> bool:
        """Whether every publisher offers transient-local durability."""
        return bool(self.qos) and all(offer.durability == "transient_local" for offer in self.qos)


@dataclass(frozen=True)
class Attachment:
    """A file carried inside the bag."""

    name: str
    media_type: str
    data: bytes


class _Sink:
    """A file without a buffer of its own: after an error it is known what is on the disk.

    The lock tells `softgrip_bag.repair` that somebody is still writing; the system releases it however the
    process ends.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX)
        self.written = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            count = os.write(self._descriptor, view)
            self.written += count
            view = view[count:]
        return len(data)

    def tell(self) -> int:
        return self.written

    def sync(self) -> None:
        os.fdatasync(self._descriptor)

    def cut(self, length: int) -> None:
        os.ftruncate(self._descriptor, length)

    def close(self) -> None:
        os.close(self._descriptor)


class McapFile:
    """One file of a bag; not thread-safe. Every method may raise OSError: then call `abandon`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.span = Span()
        self.counts: Counter[str] = Counter()
        self._sink = _Sink(path)
        self._mcap = McapStream(self._sink, CHUNK_BYTES)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._whole = 0  # [byte] end of the last complete record known

    @property
    def size(self) -> int:
        """Bytes on the disk."""
        return self._sink.written

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._mcap.add_metadata(name, values)

    def add_attachment(self, attachment: Attachment, time_ns: int) -> None:
        """Carry a file inside the bag."""
        self._mcap.add_attachment(attachment.name, attachment.media_type, attachment.data, time_ns)

    def add_topic(self, topic: Topic) -> None:
        """Register a topic; once per name."""
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._mcap.add_schema(topic.type_name, "ros2msg", topic.schema.encode())
        qos = yaml.dump([offered.as_map() for offered in topic.qos], Dumper=Plain, sort_keys=False)
        self._channels[topic.name] = self._mcap.add_channel(
            topic.name,
            self._schemas[topic.type_name],
            {"offered_qos_profiles": qos, "topic_type_hash": topic.type_hash},
        )

    def write(self, topic: str, received: int, published: int, data: bytes) -> None:
        """Write one message; times in ns since the epoch, ``data`` CDR with its header."""
        self._mcap.add_message(self._channels[topic], received, published, data)
        self.counts[topic] += 1
        self.span.add(received)

    def flush(self) -> None:
        """Close the chunk and have it on the disk when this returns."""
        self._mcap.end_chunk()
        self._sink.sync()
        self._whole = self._sink.written

    def finish(self) -> None:
        """Write the summary and close."""
        self._mcap.finish()
        self._sink.sync()
        self._sink.close()

    def abandon(self) -> None:
        """Close after a write error, cut back to the last complete chunk."""
        with contextlib.suppress(OSError):  # the disk has failed already; what can be done is done
            self._sink.cut(self._whole)
        with contextlib.suppress(OSError):
            self._sink.close()
