# SPDX-License-Identifier: Apache-2.0
"""Every whole record of an MCAP file, however the file ends.

The library's readers stop with whatever exception the first bad byte happens to cause; here a file that was cut off or
damaged gives all that is intact in it: a record counts when it is complete, a chunk when its checksum holds.
"""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema

from softgrip_bag.chunk_data import chunk_bytes, chunk_records
from softgrip_bag.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
#: A message with what describes it.
Found = tuple[Schema | None, Channel, Message]
_HEAD = struct.Struct("<BQ")
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
#: Kinds of record that are read.
ALL = frozenset({Opcode.MESSAGE, *_KINDS})
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
#: Stand beside the chunks, and are found without opening these.
BESIDE_CHUNKS = frozenset({Opcode.ATTACHMENT, Opcode.METADATA})
#: What damaged bytes make the library's parsers raise: they trust lengths and texts.
_DAMAGE = (McapError, struct.error, ValueError, EOFError, OverflowError, MemoryError)


@dataclass
class Damage:
    """What is wrong with a file: bytes that belong to no whole record, and chunks with a wrong checksum."""

    lost_bytes: int = 0
    bad_chunks: int = 0
    complete: bool = False  # the file has its end


def is_finished(path: Path) -> bool:
    """Return whether a file begins and ends as MCAP does."""
    with path.open("rb") as stream:
        size = stream.seek(0, io.SEEK_END)
        if size < 2 * len(MAGIC) + _HEAD.size:
            return False
        stream.seek(-len(MAGIC), io.SEEK_END)
        tail = stream.read()
        stream.seek(0)
        return stream.read(len(MAGIC)) == MAGIC and tail == MAGIC


def records(path: Path, damage: Damage | None = None, opcodes: Collection[int] = ALL) -> Iterator[McapRecord]:
    """Yield header, schemas, channels, messages, attachments and metadata records in the order of the file.

    Args:
        path: of the file.
        damage: filled in on the way.
        opcodes: the kinds of record to read; others are passed over.

    Raises:
        BagError: when the file does not begin as MCAP, not even the part that is there.
    """
    with path.open("rb") as stream:
        start = stream.read(len(MAGIC))
        if not MAGIC.startswith(start):
            raise BagError(f"{path}: expected MCAP, found a file that begins with {start!r}")
        yield from stream_records(stream, damage, opcodes)


@dataclass
class Directory:
    """The schemas and channels of a file by number, as far as its records were read."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def schema(self, channel: Channel) -> Schema | None:
        """Return the schema of a channel; None where it has none or it was lost."""
        return self.schemas.get(channel.schema_id)

    def messages(self, found: Iterable[McapRecord]) -> Iterator[Found]:
        """Yield the messages among records, given in the order of the file; one whose channel was lost is left out."""
        for record in found:
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Message) and record.channel_id in self.channels:
                channel = self.channels[record.channel_id]
                yield self.schema(channel), channel, record


def readable_counts(*paths: Path) -> Counter[str]:
    """Return topic -> messages that can be read back from files, finished or not.

    Raises:
        BagError: a file does not begin as MCAP.
        OSError: a file cannot be read.
    """
    return Counter(channel.topic for path in paths for _, channel, _ in Directory().messages(records(path)))


def footer_counts(path: Path) -> Counter[str]:
    """Return topic -> messages as the summary at the end of a file says.

    Raises:
        BagError: the file has no summary.
        OSError: it cannot be read.
    """
    with path.open("rb") as stream:
        try:
            summary = make_reader(stream).get_summary()
        except _DAMAGE as error:
            raise BagError(f"{path}: expected a file with a summary at its end, found {error!r}") from error
    if summary is None or summary.statistics is None:
        raise BagError(f"{path}: expected a file with a summary at its end, found none")
    counts = summary.statistics.channel_message_counts
    return Counter({summary.channels[number].topic: count for number, count in counts.items() if count})


def stream_records(
    stream: IO[bytes], damage: Damage | None = None, opcodes: Collection[int] = ALL
) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file that begins as one; arguments as for `records`."""
    damage = damage if damage is not None else Damage()
    size = stream.seek(0, io.SEEK_END)
    stream.seek(len(MAGIC))
    while True:
        at = stream.tell()
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        if opcode == Opcode.DATA_END and at + _HEAD.size + length <= size:
            damage.complete = True
            return
        if opcode == 0 or at + _HEAD.size + length > size:
            break
        if opcode in opcodes:
            yield from _parsed(opcode, stream.read(length), damage)
        else:
            stream.seek(length, io.SEEK_CUR)
    damage.lost_bytes = size - at


def _parsed(opcode: int, body: bytes, damage: Damage) -> Iterator[McapRecord]:
    try:
        record = _record(opcode, body)
        if isinstance(record, Chunk):
            yield from _inside(record)
        else:
            yield record
    except _DAMAGE:
        damage.bad_chunks += 1


def _inside(chunk: Chunk) -> Iterator[McapRecord]:
    """Yield the records of a chunk one by one: a million small ones take a hundred times their size together."""
    data = chunk_bytes(chunk)
    for opcode, start, size in chunk_records(data):
        if opcode in _IN_CHUNKS:
            yield _record(opcode, data[start : start + size])


def _record(opcode: int, body: bytes) -> McapRecord:
    data = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.MESSAGE:
        return cast("McapRecord", Message.read(data, len(body)))
    return cast("McapRecord", _KINDS[opcode].read(data))
