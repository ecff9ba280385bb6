# SPDX-License-Identifier: Apache-2.0
"""The messages of a finished MCAP file, by its chunk index; of a chunk only the wanted records are taken apart.

Most of a cell's bag is pictures and shapes, and most readers want neither. Source: MCAP specification, "Records".
"""

from __future__ import annotations

import io
import struct
from collections.abc import Collection, Iterator
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex, Message, Schema
from mcap.summary import Summary

from softgrip_bag import salvage
from softgrip_bag.chunk_data import chunk_bytes, chunk_records
from softgrip_bag.salvage import Found

#: Opcode and length of a record; of a message then channel, sequence, log time and publish time.
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


def messages(stream: IO[bytes], topics: Collection[str] | None) -> Iterator[Found]:
    """Yield the messages of a file in order of their log time; of the same time, as they were written.

    Args:
        stream: of a file with footer; without a chunk index it is read from end to end.
        topics: only these; None = all.

    Raises:
        McapError: what is there is no such file.
    """
    reader = make_reader(stream)
    summary = reader.get_summary()
    if summary is None or not summary.chunk_indexes:
        every = salvage.Directory().messages(salvage.stream_records(stream))
        chosen = (one for one in every if topics is None or one[1].topic in topics)
        yield from sorted(chosen, key=lambda one: one[2].log_time)
        return
    requested = {number for number, channel in summary.channels.items() if topics is None or channel.topic in topics}
    for together in _overlapping(summary.chunk_indexes):
        found = [
            (message.log_time, chunk.chunk_start_offset, place, message)
            for chunk in together
            if not chunk.message_index_offsets or not requested.isdisjoint(chunk.message_index_offsets)
            for place, message in enumerate(_taken_apart(stream, chunk, requested))
        ]
        for *_, message in sorted(found, key=lambda item: item[:3]):
            yield _schema(summary, message), summary.channels[message.channel_id], message


def _overlapping(chunks: Collection[ChunkIndex]) -> Iterator[list[ChunkIndex]]:
    """Yield chunks in order of time, those whose times overlap together."""
    together: list[ChunkIndex] = []
    end = 0
    for chunk in sorted(chunks, key=lambda c: (c.message_start_time, c.chunk_start_offset)):
        if together and chunk.message_start_time >= end:
            yield together
            together = []
        together.append(chunk)
        end = max(end, chunk.message_end_time)
    if together:
        yield together


def _taken_apart(stream: IO[bytes], index: ChunkIndex, requested: Collection[int]) -> Iterator[Message]:
    stream.seek(index.chunk_start_offset)
    opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
    if opcode != Opcode.CHUNK:
        raise McapError(f"expected a chunk at byte {index.chunk_start_offset}, found record {opcode}")
    data = chunk_bytes(Chunk.read(ReadDataStream(io.BytesIO(stream.read(length)))))
    for opcode, start, size in chunk_records(data):
        if opcode == Opcode.MESSAGE:
            if size < _MESSAGE.size:
                raise EndOfFile
            channel, sequence, logged, published = _MESSAGE.unpack_from(data, start)
            if channel in requested:
                body = data[start + _MESSAGE.size : start + size]
                yield Message(channel_id=channel, sequence=sequence, log_time=logged, publish_time=published, data=body)


def _schema(summary: Summary, message: Message) -> Schema | None:
    return summary.schemas.get(summary.channels[message.channel_id].schema_id)
