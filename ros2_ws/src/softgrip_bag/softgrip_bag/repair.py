# SPDX-License-Identifier: Apache-2.0
"""Finish bags that were cut off: by kill -9, by a power cut, by a full disk."""

from __future__ import annotations

import fcntl
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from softgrip_bag import metadata, salvage
from softgrip_bag.errors import BagError
from softgrip_bag.metadata import FileEntry, Span, TopicEntry
from softgrip_bag.reader import bag_files
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
        """Say it in one line."""
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


def repair(bag: Path) -> Repaired:
    """Rewrite the unfinished files of a bag with all that is intact in them, and its metadata.yaml.

    A file is replaced only when its successor is complete on the disk.

    Raises:
        BagError: no bag, no MCAP, being recorded, or no room or permission to write.
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
            contents.append(_rewrite(path, own))
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


def repair_all(root: Path) -> Iterator[Repaired | BagError]:
    """Repair every broken bag in a folder of bags that nobody is writing; yields what was done or why not."""
    for bag in sorted(root.iterdir()) if root.is_dir() else ():
        try:
            if bag.is_dir() and is_broken(bag) and not is_being_written(bag):
                yield repair(bag)
        except BagError as error:
            yield error
        except OSError as error:
            yield BagError(f"{bag}: cannot be read: {error.strerror}")


def _content(path: Path) -> _Content:
    content = _Content(Span(), {})
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for record in salvage.records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
            content.topics.setdefault(record.topic, _entry(record, schemas))
        elif isinstance(record, Message) and record.channel_id in channels:
            content.span.add(record.log_time)
            content.topics[channels[record.channel_id].topic].messages += 1
    return content


def _rewrite(path: Path, damage: salvage.Damage) -> _Content:
    with replacing_durably(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        started = False
        for record in salvage.records(path, damage):
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


def _entry(channel: Channel, schemas: dict[int, Schema]) -> TopicEntry:
    schema = schemas.get(channel.schema_id)
    qos = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
    return TopicEntry(channel.topic, schema.name if schema else "", channel.metadata.get("topic_type_hash", ""), qos)


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
