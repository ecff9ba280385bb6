# SPDX-License-Identifier: Apache-2.0
"""Finish bags that were cut off: by kill -9, by a power cut, by a full disk."""

from __future__ import annotations

import fcntl
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from softgrip_bag import metadata, salvage
from softgrip_bag.errors import BagError
from softgrip_bag.metadata import FileEntry, Span, TopicEntry
from softgrip_bag.reader import bag_files, offered_qos
from softgrip_model.durable import replacing_durably


@dataclass(frozen=True)
class Repaired:
    """What was done to a bag."""

    bag: Path
    rewritten: tuple[Path, ...]
    messages: int
    lost_bytes: int
    bad_chunks: int

    def __str__(self) -> str:
        """Return it in one line."""
        lost = f", {self.lost_bytes} bytes and {self.bad_chunks} chunks could not be read" if self.rewritten else ""
        return f"{self.bag}: {len(self.rewritten)} files finished, {self.messages} messages readable{lost}"


@dataclass
class _Content:
    span: Span
    topics: dict[str, TopicEntry]


def is_broken(bag: Path) -> bool:
    """Return whether a bag lacks an end or its metadata.yaml; one without files is not a bag and not broken."""
    files = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    unfinished = any(not salvage.is_finished(file) for file in files)
    return bool(files) and (unfinished or (bag.is_dir() and not (bag / metadata.FILE_NAME).is_file()))


def is_being_written(bag: Path) -> bool:
    """Return whether a recorder still holds one of the files."""
    for path in bag_files(bag):
        with path.open("rb") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                return True
    return False


def never() -> bool:
    """Return that nobody wants to cancel."""
    return False


def repair(bag: Path, is_cancelled: Callable[[], bool] = never) -> Repaired:
    """Rewrite the unfinished files of a bag with all that is intact in them, and its metadata.yaml.

    A file is replaced only when its successor is complete on the disk.

    Args:
        bag: folder or .mcap file.
        is_cancelled: asked at each record; True ends the work and leaves the bag as it is.

    Raises:
        BagError: no bag, no MCAP, being recorded, no room or permission to write, or cancelled.
    """
    files = bag_files(bag)
    if is_being_written(bag):
        raise BagError(f"expected a bag that nobody writes, found that {bag} is being recorded; stop the recorder")
    damage = salvage.Damage()
    rewritten = []
    contents = []
    try:
        for path in files:
            if salvage.is_finished(path):
                contents.append(_content(path))
                continue
            own = salvage.Damage()
            contents.append(_rewrite(path, own, is_cancelled))
            damage.lost_bytes += own.lost_bytes
            damage.bad_chunks += own.bad_chunks
            rewritten.append(path)
        if bag.is_dir():
            entries = [FileEntry(path.name, content.span) for path, content in zip(files, contents, strict=True)]
            metadata.write(bag, metadata.information(entries, _merged(contents)))
    except OSError as error:
        raise BagError(f"{bag}: cannot be repaired: {error.strerror} ({error.filename or 'while writing'})") from error
    messages = sum(content.span.messages for content in contents)
    return Repaired(bag, tuple(rewritten), messages, damage.lost_bytes, damage.bad_chunks)


def bags_in(root: Path) -> list[Path]:
    """Return the folders in a folder of bags; empty when it cannot be read."""
    try:
        return sorted(path for path in root.iterdir() if path.is_dir())
    except OSError:
        return []


def repair_all(bags: Iterable[Path], is_cancelled: Callable[[], bool] = never) -> Iterator[Repaired | BagError]:
    """Repair every broken bag of some that nobody is writing; yields what was done or why not."""
    for bag in bags:
        if is_cancelled():
            return
        try:
            if is_broken(bag) and not is_being_written(bag):
                yield repair(bag, is_cancelled)
        except BagError as error:
            yield error
        except OSError as error:
            yield BagError(f"{bag}: cannot be read: {error.strerror}")


def _content(path: Path) -> _Content:
    span, counts, directory = Span(), Counter[str](), salvage.Directory()
    for _, channel, message in directory.messages(salvage.records(path)):
        span.add(message.log_time)
        counts[channel.topic] += 1
    topics: dict[str, TopicEntry] = {}
    for channel in directory.channels.values():
        schema = directory.schema(channel)
        type_hash = channel.metadata.get("topic_type_hash", "")
        entry = TopicEntry(channel.topic, schema.name if schema else "", type_hash, list(offered_qos(channel)))
        entry.messages = counts[channel.topic]
        topics.setdefault(channel.topic, entry)
    return _Content(span, topics)


def _rewrite(path: Path, damage: salvage.Damage, is_cancelled: Callable[[], bool]) -> _Content:
    with replacing_durably(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        started = False
        for record in salvage.records(path, damage):
            if is_cancelled():
                raise BagError(f"{path}: its repair was cancelled; the file is as it was")
            if isinstance(record, Header):
                started = True
                writer.start(profile=record.profile, library=record.library)
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas.get(record.schema_id, 0), record.metadata
                )
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            elif isinstance(record, Attachment):
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
        if not started:
            writer.start(profile="ros2", library="softgrip_bag")
        writer.finish()  # type: ignore[no-untyped-call]  # the library has no types
    return _content(path)


def _merged(contents: list[_Content]) -> list[TopicEntry]:
    counts: Counter[str] = Counter()
    found: dict[str, TopicEntry] = {}
    for content in contents:
        for name, entry in content.topics.items():
            counts[name] += entry.messages
            found[name] = TopicEntry(name, entry.type_name, entry.type_hash, entry.qos)
    for name, entry in found.items():
        entry.messages = counts[name]
    return list(found.values())
