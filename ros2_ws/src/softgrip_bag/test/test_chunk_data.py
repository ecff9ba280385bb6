# SPDX-License-Identifier: Apache-2.0
"""A few bytes of a bag do not take the computer's memory."""

from __future__ import annotations

import io
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Message, Schema

from softgrip_bag.chunk_data import FREE_BYTES, ChunkError, chunk_bytes
from softgrip_bag.reader import read
from softgrip_bag.repair import repair
from softgrip_bag.salvage import MAGIC, Damage, records

BOMB_BYTES = 400_000_000
Pack = Callable[[bytes], bytes]


def zeros(pack: str) -> bytes:
    """Pack many zeros without having them at once."""
    block = bytes(1_000_000)
    out = io.BytesIO()
    if pack == "lz4":
        with lz4.frame.open(out, "wb") as stream:
            for _ in range(BOMB_BYTES // len(block)):
                stream.write(block)
        return out.getvalue()
    size = BOMB_BYTES if pack == "zstd" else -1
    with zstandard.ZstdCompressor(level=1).stream_writer(out, size=size, closefd=False) as stream:
        for _ in range(BOMB_BYTES // len(block)):
            stream.write(block)
    return out.getvalue()


def chunk(data: bytes, size: int, compression: str = "zstd", crc: int = 0) -> Chunk:
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=crc,
        uncompressed_size=size,
    )


@pytest.mark.parametrize("says", [BOMB_BYTES, 1000])
@pytest.mark.parametrize("pack", ["zstd", "zstd without size", "lz4"])
def test_a_bomb_is_refused_before_it_takes_memory(pack: str, says: int) -> None:
    """Whether the chunk tells the size, or lies about it."""
    packed = zeros(pack)
    assert len(packed) < BOMB_BYTES / 200
    tracemalloc.start()
    try:
        with pytest.raises(ChunkError):
            chunk_bytes(chunk(packed, says, pack.split(maxsplit=1)[0]))
        assert tracemalloc.get_traced_memory()[1] < FREE_BYTES
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_what_is_packed_as_tightly_as_black_pictures_is_read(compression: str) -> None:
    data = bytes(20_000_000)
    pack: dict[str, Pack] = {"zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress, "": bytes}
    packed = pack[compression](data)
    assert chunk_bytes(chunk(packed, len(data), compression, zlib.crc32(data))) == data
    with pytest.raises(ChunkError, match="checksum"):
        chunk_bytes(chunk(packed, len(data), compression, zlib.crc32(data) ^ 1))


def test_an_unknown_compression_is_named() -> None:
    with pytest.raises(ChunkError, match="'brotli'"):
        chunk_bytes(chunk(b"", 0, "brotli"))


def record(*parts: object) -> bytes:
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    return bytes(builder.end())


def test_repair_of_a_file_with_a_bomb_keeps_the_rest(tmp_path: Path) -> None:
    inside = record(
        Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data"),
        Channel(id=1, topic="/a", message_encoding="cdr", metadata={}, schema_id=1),
        Message(channel_id=1, sequence=0, log_time=1, publish_time=1, data=b"\0\1\0\0\1\0\0\0\0"),
    )
    packed = zstandard.ZstdCompressor().compress(inside)
    good = chunk(packed, len(inside), crc=zlib.crc32(inside))
    folder = tmp_path / "bag"
    folder.mkdir()
    path = folder / "bag_0.mcap"
    path.write_bytes(MAGIC + record(Header("ros2", "x"), chunk(zeros("zstd"), BOMB_BYTES), good))
    damage = Damage()
    tracemalloc.start()
    try:
        list(records(path, damage))
        done = repair(folder)
        assert tracemalloc.get_traced_memory()[1] < FREE_BYTES
    finally:
        tracemalloc.stop()
    assert damage.bad_chunks == 1
    assert (done.messages, done.bad_chunks) == (1, 1)
    assert [message.topic for message in read(folder)] == ["/a"]


def test_many_small_records_are_not_held_at_once(tmp_path: Path) -> None:
    """As messages they would take a hundred times their bytes together."""
    one = record(Message(channel_id=1, sequence=0, log_time=1, publish_time=1, data=b""))
    inside = one * 50_000
    path = tmp_path / "small.mcap"
    path.write_bytes(MAGIC + record(Header("ros2", "x"), chunk(zstandard.compress(inside), len(inside))))
    found = records(path)
    next(found)
    tracemalloc.start()
    try:
        count = sum(1 for _ in found)
        assert tracemalloc.get_traced_memory()[1] < 4 * len(inside)
    finally:
        tracemalloc.stop()
    assert count == 50_000
