# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file in their order: chunks with indexes, and the summary at the end.

The `mcap` library's writer spends most of its time on a message in putting single numbers into a buffer. Here a message
costs one packed header, and a chunk one join; every other record is the library's own.

Source: MCAP specification, "Records" and "Summary section".
"""

from __future__ import annotations

import struct
import zlib
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from softgrip_bag.errors import RecordRefusedError

MAGIC = b"\x89MCAP0\r\n"
#: Opcode, length, then Message's fields before the data: channel, sequence, log time, publish time.
_MESSAGE = struct.Struct("<BQHIQQ")
#: Ids of schemas and channels have 16 bits, and begin with 1.
MAX_ID = 2**16 - 1
_MESSAGE_FIELDS = _MESSAGE.size - 9  # without opcode and length
#: zstd's fastest ordinary level: rosbag2's preset `zstd_fast` uses it too.
_LEVEL = 1


class Sink(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes) -> int:
        """Take bytes."""

    def tell(self) -> int:
        """How many were taken."""


class _ChunkInProgress:
    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.first = self.last = 0  # [ns]
        self.index: dict[int, list[int]] = {}  # channel -> log time, offset, log time, offset, ...

    def add(self, record: bytes) -> None:
        self.parts.append(record)
        self.size += len(record)


class McapStream:
    """Writes one MCAP file into a sink; not thread-safe.

    Args:
        sink: takes the bytes.
        chunk_bytes: a chunk is closed beyond this size.
    """

    def __init__(self, sink: Sink, chunk_bytes: int) -> None:
        self._sink = sink
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._chunk = _ChunkInProgress()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._first, self._last = 0, 0  # [ns]
        self._chunks: list[bytes] = []  # their indexes as they will be written: a sixth of the memory
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        sink.write(MAGIC + _bytes(Header("ros2", "softgrip_bag")))

    @property
    def chunks(self) -> int:
        """How many chunks the sink has got whole."""
        return len(self._chunks)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema; returns its id.

        Raises:
            RecordRefusedError: there are as many as ids.
        """
        _check_room(len(self._schemas), "schemas")
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._chunk.add(_bytes(schema))
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Register a channel of CDR messages; returns its id.

        Raises:
            RecordRefusedError: there are as many as ids.
        """
        _check_room(len(self._channels), "channels")
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding="cdr", schema_id=schema, metadata=metadata
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._chunk.add(_bytes(channel))
        return channel.id

    def add_message(self, channel: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Write a message; times in ns since the epoch."""
        chunk = self._chunk
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE_FIELDS + len(data), channel, 0, log_time, publish_time)
        index = chunk.index.get(channel)
        if index is None:
            index = chunk.index[channel] = []
        index += (log_time, chunk.size)
        chunk.parts += (head, data)
        chunk.size += _MESSAGE.size + len(data)
        if chunk.size > self._chunk_bytes:
            self.end_chunk()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        offset = self._sink.tell()
        length = self._put(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Carry a file."""
        offset = self._sink.tell()
        length = self._put(
            Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data)
        )
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                create_time=time_ns,
                log_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def end_chunk(self) -> None:
        """Close the chunk in progress and hand it to the sink; one without messages stays open."""
        chunk = self._chunk
        if not chunk.index:
            return
        self._chunk = _ChunkInProgress()
        times = [time for index in chunk.index.values() for time in index[::2]]
        chunk.first, chunk.last = min(times), max(times)
        content = b"".join(chunk.parts)
        compressed = self._compressor.compress(content)
        record = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=chunk.first,
            message_end_time=chunk.last,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        start = self._sink.tell()
        length = self._put(record)
        offsets, indexes = _message_indexes(chunk, start + length)
        self._sink.write(indexes)
        self._note(chunk, offsets)
        index = ChunkIndex(
            message_start_time=chunk.first,
            message_end_time=chunk.last,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=len(indexes),
            compression="zstd",
            compressed_size=len(compressed),
            uncompressed_size=len(content),
        )
        self._chunks.append(_bytes(index))

    def finish(self) -> None:
        """Write what is left, the summary and the end."""
        self.end_chunk()
        self._put(DataEnd(0))
        at = start = self._sink.tell()
        groups: list[bytes] = []
        offsets: list[bytes] = []
        for opcode, records in self._summary():
            if records:
                group = b"".join(records)
                groups.append(group)
                offsets.append(_bytes(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(group))))
                at += len(group)
        data = b"".join(groups + offsets)
        head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, at)
        footer = Footer(summary_start=start, summary_offset_start=at, summary_crc=zlib.crc32(head, zlib.crc32(data)))
        self._sink.write(data + _bytes(footer) + MAGIC)

    def _put(self, record: McapRecord) -> int:
        data = _bytes(record)
        self._sink.write(data)
        return len(data)

    def _note(self, chunk: _ChunkInProgress, channels: dict[int, int]) -> None:
        self._first = min(self._first, chunk.first) if self._chunks else chunk.first
        self._last = max(self._last, chunk.last)
        for channel in channels:
            self._counts[channel] += len(chunk.index[channel]) // 2

    def _summary(self) -> list[tuple[Opcode, list[bytes]]]:
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self._first,
            message_end_time=self._last,
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, [_bytes(schema) for schema in self._schemas]),
            (Opcode.CHANNEL, [_bytes(channel) for channel in self._channels]),
            (Opcode.STATISTICS, [_bytes(statistics)]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, [_bytes(attachment) for attachment in self._attachments]),
            (Opcode.METADATA_INDEX, [_bytes(metadata) for metadata in self._metadata]),
        ]


def _check_room(present: int, kind: str) -> None:
    if present >= MAX_ID:
        raise RecordRefusedError(f"expected at most {MAX_ID} {kind} in a file, which is MCAP's limit, found one more")


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # the library has no types


def _message_indexes(chunk: _ChunkInProgress, start: int) -> tuple[dict[int, int], bytes]:
    """Return channel -> offset of its index in the file, and the bytes of all of them, which begin at ``start``."""
    offsets: dict[int, int] = {}
    records: list[bytes] = []
    at = start
    for channel, index in chunk.index.items():
        offsets[channel] = at
        size = 8 * len(index)
        record = struct.pack(f"<BQHI{len(index)}Q", Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size, *index)
        records.append(record)
        at += len(record)
    return offsets, b"".join(records)
