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

from softgrip_bag import salvage
from softgrip_bag.errors import BagError, RecordRefusedError
from softgrip_bag.mcap_stream import McapStream
from softgrip_bag.metadata import Plain, Span
from softgrip_bag.offers import OfferedQos

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

    def __init__(self) -> None:
        self._descriptor = -1
        self.is_open = False
        self.written = 0

    def open(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self.is_open = True
        fcntl.flock(self._descriptor, fcntl.LOCK_EX)

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
        """Close once: the system may give the number to another file at once."""
        if self.is_open:
            self.is_open = False
            os.close(self._descriptor)


class McapFile:
    """One file of a bag; not thread-safe. Call `open` first. Every method may raise: then call `abandon`.

    Attributes:
        span: of all messages taken.
        counts: topic -> messages taken.
        stored: topic -> messages in chunks that the file has whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.span = Span()
        self.counts: Counter[str] = Counter()
        self.stored: Counter[str] = Counter()
        self._sink = _Sink()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._whole = 0  # [byte] end of the last complete record known
        self._is_synced = True

    def open(self) -> None:
        """Create the file; it must not exist."""
        self._sink.open(self.path)
        self._mcap = McapStream(self._sink, CHUNK_BYTES)
        self._whole = self._sink.written

    @property
    def size(self) -> int:
        """Bytes on the disk."""
        return self._sink.written

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._mcap.add_metadata(name, values)
        self._whole = self._sink.written

    def add_attachment(self, attachment: Attachment, time_ns: int) -> None:
        """Carry a file inside the bag."""
        self._mcap.add_attachment(attachment.name, attachment.media_type, attachment.data, time_ns)
        self._whole = self._sink.written

    def add_topic(self, topic: Topic) -> None:
        """Register a topic; once per name.

        Raises:
            RecordRefusedError: the file has as many as it can.
        """
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._mcap.add_schema(topic.type_name, "ros2msg", topic.schema.encode())
        qos = yaml.dump([offered.as_map() for offered in topic.qos], Dumper=Plain, sort_keys=False)
        self._channels[topic.name] = self._mcap.add_channel(
            topic.name,
            self._schemas[topic.type_name],
            {"offered_qos_profiles": qos, "topic_type_hash": topic.type_hash},
        )

    def write(self, topic: str, received: int, published: int, data: bytes) -> None:
        """Write one message; times in ns since the epoch, ``data`` CDR with its header.

        Raises:
            RecordRefusedError: no such topic.
        """
        channel = self._channels.get(topic)
        if channel is None:
            raise RecordRefusedError(f"expected a topic that was registered, found {topic!r}")
        chunks = self._mcap.chunks
        self._mcap.add_message(channel, received, published, data)
        self.counts[topic] += 1
        self.span.add(received)
        if self._mcap.chunks != chunks:
            self._mark_chunk()

    def flush(self) -> None:
        """Close the chunk and have it on the disk when this returns."""
        self._mcap.end_chunk()
        self._mark_chunk()
        self._sync()

    def finish(self) -> None:
        """Write the summary and close.

        Raises:
            BagError: the file's end does not say that all messages are in it.
        """
        self._mcap.end_chunk()
        self._mark_chunk()
        self._mcap.finish()
        self._sync()
        self._sink.close()
        del self._mcap  # its chunks' indexes: a bag of many files must not keep those of all
        found = salvage.footer_counts(self.path)
        if found != +self.counts:
            raise BagError(
                f"{self.path}: expected {self.counts.total()} messages in the file's summary, found {found.total()}; "
                "the disk or this computer's memory is damaged: keep the file, record elsewhere"
            )

    def abandon(self) -> None:
        """Close after an error, cut back to the last complete chunk; `stored` is then what can be read back."""
        try:
            if not self._sink.is_open:
                return
            self._sink.cut(self._whole)
            is_known = self._is_synced
        except OSError:  # a disk that does not even cut: what is there is counted below
            is_known = False
        finally:
            with contextlib.suppress(OSError):  # the descriptor is gone in any case, close(2)
                self._sink.close()
        if not is_known:
            self.stored = _read_back(self.path)

    def _mark_chunk(self) -> None:
        stored = self.counts.copy()  # an exception in the copy must leave both as they were
        self.stored, self._whole = stored, self._sink.written

    def _sync(self) -> None:
        self._is_synced = False
        self._sink.sync()
        self._is_synced = True


def _read_back(path: Path) -> Counter[str]:
    """Return what can be read from a file on a disk that has failed: nothing, when the file is gone."""
    try:
        return salvage.readable_counts(path)
    except (OSError, BagError):
        return Counter()
