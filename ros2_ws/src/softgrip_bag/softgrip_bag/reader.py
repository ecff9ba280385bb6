# SPDX-License-Identifier: Apache-2.0
"""Read a bag: raw CDR messages in the order they were received, with their types.

Finished files are read through their index; files that were cut off give all that is intact in them.
"""

from __future__ import annotations

import functools
import hashlib
import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema, Statistics

from softgrip_bag import indexed, mcap_file, salvage
from softgrip_bag.errors import BagError

_DIGITS = 16
_BLOCK = 1 << 20  # [byte] read at a time


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One recorded message: times in ns since the epoch, ``data`` CDR with its header."""

    topic: str
    type_name: str
    received: int
    published: int
    data: bytes


@dataclass(frozen=True)
class TopicSummary:
    """A topic of a bag, as its channel describes it."""

    name: str
    type_name: str
    type_hash: str
    qos: tuple[dict[str, object], ...]
    messages: int
    schema: str = ""  # ros2msg text

    @property
    def latched(self) -> bool:
        """Whether every publisher offered transient-local durability."""
        # words since metadata version 9, numbers before (rmw: 1 = transient local)
        return bool(self.qos) and all(offer.get("durability") in {"transient_local", 1} for offer in self.qos)


def bag_files(bag: Path) -> list[Path]:
    """Return the MCAP files of a bag in the order they were written: a folder, or a single file.

    Raises:
        BagError: when there is none.
    """
    files = sorted(bag.glob("*.mcap"), key=_number) if bag.is_dir() else [bag]
    if not files or not all(file.is_file() for file in files):
        raise BagError(f"expected a bag (a folder with .mcap files, or one such file), found none at {bag}")
    return files


def bag_digest(bag: Path) -> str:
    """Return the first 16 digits of the SHA-256 of a bag's MCAP files, in their order.

    Raises:
        BagError: there is no bag.
    """
    total = hashlib.sha256()
    for path in bag_files(bag):
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()[:_DIGITS]


def read(bag: Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in order of reception.

    Args:
        bag: folder or .mcap file.
        topics: only these; None = all.

    Raises:
        BagError: when a file is not MCAP.
    """
    for path in bag_files(bag):
        requested = None if topics is None else set(topics)
        if salvage.is_finished(path):
            yield from _indexed(path, requested)
        else:
            yield from sorted(_salvaged(path, requested), key=lambda message: message.received)


def when_published(message: RawMessage) -> tuple[int, int]:
    """Return when a message was published [ns]: an order for `in_order`."""
    return message.published, 0


def in_order(
    messages: Iterable[RawMessage],
    key: Callable[[RawMessage], tuple[int, int]] = when_published,
    lag_ns: int = 30_000_000_000,
) -> Iterator[RawMessage]:
    """Yield messages, given in order of reception, in another order, without holding all of them.

    A recorder that falls behind takes its topics in turns, and one of them may be seconds later than another.

    Args:
        messages: in order of reception.
        key: a time of each [ns], and what comes first at the same time; else what was received first does.
        lag_ns: a message received later than this after its time keeps the place that it came in [ns].
    """
    waiting: list[tuple[tuple[int, int], int, RawMessage]] = []
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (key(message), number, message))
        while waiting and waiting[0][0][0] < message.received - lag_ns:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def topic_summaries(bag: Path) -> list[TopicSummary]:
    """Return every topic of a bag, by name.

    Raises:
        BagError: when a file is not MCAP.
    """
    found: dict[str, TopicSummary] = {}
    for path in bag_files(bag):
        for channel, schema, count in _channels(path):
            before = found.get(channel.topic)
            found[channel.topic] = TopicSummary(
                channel.topic,
                schema.name if schema else "",
                channel.metadata.get("topic_type_hash", ""),
                offered_qos(channel),
                count + (before.messages if before else 0),
                schema.data.decode(errors="replace") if schema else "",
            )
    return [found[name] for name in sorted(found)]


def attachments(bag: Path) -> list[mcap_file.Attachment]:
    """Return the files that a bag carries; of the same name, the last one."""
    found: dict[str, mcap_file.Attachment] = {}
    for path in bag_files(bag):
        for record in salvage.records(path, opcodes=salvage.BESIDE_CHUNKS):
            if isinstance(record, Attachment):
                found[record.name] = mcap_file.Attachment(record.name, record.media_type, record.data)
    return list(found.values())


def facts(bag: Path) -> dict[str, dict[str, str]]:
    """Return the metadata records of a bag; of the same name, the last one."""
    found: dict[str, dict[str, str]] = {}
    for path in bag_files(bag):
        beside = salvage.records(path, opcodes=salvage.BESIDE_CHUNKS)
        found |= {r.name: r.metadata for r in beside if isinstance(r, Metadata)}
    return found


@functools.cache
def _offered(text: str) -> tuple[dict[str, object], ...]:
    """Topics of a cell offer few different profiles; YAML is slow. Of other tools, what is no list of maps is none."""
    try:
        offered = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return ()
    return tuple(one for one in offered if isinstance(one, dict)) if isinstance(offered, list) else ()


def offered_qos(channel: Channel) -> tuple[dict[str, object], ...]:
    """Return rosbag2's maps of what the publishers of a channel offered."""
    return _offered(channel.metadata.get("offered_qos_profiles", ""))


def _number(path: Path) -> tuple[int, str]:
    """Order of files: name_2.mcap comes before name_10.mcap."""
    last = path.stem.rpartition("_")[2]
    return (int(last) if last.isdecimal() else 0, path.name)


def _indexed(path: Path, topics: set[str] | None) -> Iterator[RawMessage]:
    with path.open("rb") as stream:
        try:
            for schema, channel, message in indexed.messages(stream, topics):
                yield _raw(channel, schema, message)
        except McapError as error:
            raise BagError(f"{path}: expected MCAP, found {error!r}; try `ros2 run softgrip_bag repair`") from error


def _salvaged(path: Path, topics: set[str] | None) -> Iterator[RawMessage]:
    for schema, channel, message in salvage.Directory().messages(salvage.records(path)):
        if topics is None or channel.topic in topics:
            yield _raw(channel, schema, message)


def _raw(channel: Channel, schema: Schema | None, message: Message) -> RawMessage:
    type_name = schema.name if schema else ""
    return RawMessage(channel.topic, type_name, message.log_time, message.publish_time, message.data)


def _channels(path: Path) -> list[tuple[Channel, Schema | None, int]]:
    with path.open("rb") as stream:
        if salvage.is_finished(path):
            found = _from_summary(stream, path)
            if found is not None:
                return found
    directory = salvage.Directory()
    counts = Counter(channel.id for _, channel, _ in directory.messages(salvage.records(path)))
    return [(channel, directory.schema(channel), counts[channel.id]) for channel in directory.channels.values()]


def _from_summary(stream: IO[bytes], path: Path) -> list[tuple[Channel, Schema | None, int]] | None:
    try:
        summary = make_reader(stream).get_summary()
    except McapError as error:
        raise BagError(f"{path}: expected MCAP, found {error!r}; try `ros2 run softgrip_bag repair`") from error
    if summary is None or summary.statistics is None:
        return None
    statistics: Statistics = summary.statistics
    return [
        (channel, summary.schemas.get(channel.schema_id), statistics.channel_message_counts.get(channel.id, 0))
        for channel in summary.channels.values()
    ]
