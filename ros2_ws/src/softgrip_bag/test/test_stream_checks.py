# SPDX-License-Identifier: Apache-2.0
"""Checksums and indexes of a written file, worked out from the bytes by the MCAP specification."""

from __future__ import annotations

import io
import struct
import zlib

import pytest
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError
from mcap.writer import CompressionType, IndexType, Writer

from softgrip_bag import indexed
from softgrip_bag.mcap_stream import McapStream

MESSAGE, CHUNK, MESSAGE_INDEX, FOOTER = 0x05, 0x06, 0x07, 0x02


def file_of(times: list[int]) -> bytes:
    sink = io.BytesIO()
    stream = McapStream(sink, chunk_bytes=300)
    schema = stream.add_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channels = [stream.add_channel(topic, schema, {}) for topic in ("/a", "/b")]
    for number, time in enumerate(times):
        stream.add_message(channels[number % 2], time, time - 10, b"%050d" % number)
    stream.finish()
    return sink.getvalue()


def records(data: bytes, at: int = 8, end: int | None = None) -> list[tuple[int, int, bytes]]:
    """Opcode, place and body of every record from ``at`` on."""
    found = []
    while at < (len(data) - 8 if end is None else end):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, data[at + 9 : at + 9 + size]))
        at += 9 + size
    return found


def content(body: bytes) -> tuple[int, int, int, bytes]:
    """First and last time, checksum and content of a chunk."""
    first, last, size, crc, name = struct.unpack_from("<QQQII", body)
    start = 32 + name + 8
    return first, last, crc, zstandard.ZstdDecompressor().decompress(body[start:], max_output_size=size)


def test_every_chunk_has_the_checksum_and_the_times_of_its_content() -> None:
    chunks = [body for opcode, _, body in records(file_of([100, 97, 103, 99, *range(104, 140)])) if opcode == CHUNK]
    assert len(chunks) > 3
    for body in chunks:
        first, last, crc, inside = content(body)
        times = [struct.unpack_from("<Q", r, 6)[0] for op, _, r in records(inside, 0, len(inside)) if op == MESSAGE]
        assert crc == zlib.crc32(inside) != 0
        assert (first, last) == (min(times), max(times))


def test_every_entry_of_a_message_index_points_at_its_message() -> None:
    seen, inside = 0, b""
    for opcode, _, body in records(file_of(list(range(100, 140)))):
        if opcode == CHUNK:
            *_, inside = content(body)
        if opcode == MESSAGE_INDEX:
            channel, size = struct.unpack_from("<HI", body)
            for time, offset in struct.iter_unpack("<QQ", body[6 : 6 + size]):
                assert inside[offset] == MESSAGE
                found_channel, _, found_time = struct.unpack_from("<HIQ", inside, offset + 9)
                assert (found_channel, found_time) == (channel, time)
                seen += 1
    assert seen == 40


def test_the_summary_s_checksum_goes_from_its_begin_to_the_footer_s_offsets() -> None:
    data = file_of(list(range(100, 140)))
    opcode, at, body = records(data)[-1]
    start, offsets, crc = struct.unpack("<QQI", body)
    assert opcode == FOOTER
    assert start < offsets < at
    assert crc == zlib.crc32(data[start : at + 9 + 16])


def test_a_flipped_byte_is_noticed_by_the_library_s_reader() -> None:
    data = bytearray(file_of(list(range(100, 140))))
    reader = make_reader(io.BytesIO(bytes(data)), validate_crcs=True)
    assert len(list(reader.iter_messages())) == 40
    summary = reader.get_summary()
    assert summary is not None
    index = summary.chunk_indexes[1]
    # The last bytes of a compressed chunk are literals: they decompress, to something else.
    data[index.chunk_start_offset + index.chunk_length - 4] ^= 0x01
    with pytest.raises((CRCValidationError, McapError, zstandard.ZstdError)):
        list(make_reader(io.BytesIO(bytes(data)), validate_crcs=True).iter_messages())


def test_a_file_without_message_indexes_is_read_by_its_chunks() -> None:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=50, index_types=IndexType.CHUNK)
    writer.start()
    channels = [writer.register_channel(topic, "cdr", 0) for topic in ("/a", "/b")]
    for number in range(20):
        writer.add_message(channels[number % 2], number, b"%09d" % number, number)
    writer.finish()
    found = [m.log_time for _, _, m in indexed.messages(io.BytesIO(stream.getvalue()), ["/b"])]
    assert found == list(range(1, 20, 2))


def test_a_message_shorter_than_its_own_fields_is_an_error() -> None:
    """Channel, sequence and two times are 22 bytes; here a length of 3 is followed by what reads as a whole record."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    # From its fourth byte on the message reads as opcode 0x0c and a length of 17, which ends with the chunk.
    channel = writer.register_channel("/a", "cdr", 0)
    writer.add_message(channel, 0, b"payload", 1, sequence=(17 << 16) | (0x0C << 8))
    writer.finish()
    data = bytearray(stream.getvalue())
    start = data.index(b"payload") - 22 - 8
    assert int.from_bytes(data[start : start + 8], "little") == 22 + 7
    data[start : start + 8] = (3).to_bytes(8, "little")
    with pytest.raises(McapError):
        list(indexed.messages(io.BytesIO(bytes(data)), None))
