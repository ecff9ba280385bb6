# SPDX-License-Identifier: Apache-2.0
"""Reading by the chunk index, against the mcap library's own reader."""

from __future__ import annotations

import io
from random import Random

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from softgrip_bag import indexed

TOPICS = ("/a", "/b", "/c")


def mcap_bytes(times: list[int], *, chunk_size: int = 200, use_chunking: bool = True) -> bytes:
    """A file whose chunks hold some messages each; topics take turns at random."""
    rng, stream = Random(7), io.BytesIO()
    writer = Writer(stream, chunk_size=chunk_size, use_chunking=use_chunking)
    writer.start()
    schema = writer.register_schema("s", "ros2msg", b"string data")
    channels = [writer.register_channel(topic, "cdr", schema) for topic in TOPICS]
    for number, time in enumerate(times):
        writer.add_message(rng.choice(channels), time, b"%d" % number * rng.randint(1, 9), time + 1, number)
    writer.finish()
    return stream.getvalue()


def by_library(data: bytes, topics: list[str] | None) -> list[tuple[str, int, int, bytes]]:
    found = make_reader(io.BytesIO(data)).iter_messages(topics=topics)
    return [(channel.topic, m.log_time, m.publish_time, m.data) for _, channel, m in found]


@pytest.mark.parametrize("topics", [None, ["/a"], ["/b", "/c"], ["/nobody"], []])
@pytest.mark.parametrize("spread", [0, 3, 40, 1000])
def test_the_same_messages_in_the_same_order_as_the_library_reads(spread: int, topics: list[str] | None) -> None:
    """Times that go back by up to ``spread``: chunks that overlap not at all, with their neighbours, or all."""
    rng = Random(spread)
    data = mcap_bytes([10 * number // 3 + rng.randint(0, spread) for number in range(300)])
    found = list(indexed.messages(io.BytesIO(data), topics))
    assert [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in found] == by_library(data, topics)
    assert {schema.name for schema, _, _ in found if schema} <= {"s"}


def test_a_file_without_chunks_is_read_from_end_to_end() -> None:
    data = mcap_bytes([3, 1, 2], use_chunking=False)
    assert [m.log_time for _, _, m in indexed.messages(io.BytesIO(data), None)] == [1, 2, 3]
    assert len(by_library(data, None)) == 3


def test_a_chunk_that_ends_within_a_record_is_an_error() -> None:
    """The length of the first message of a chunk that is not compressed is made to reach beyond it."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start()
    writer.add_message(writer.register_channel("/a", "cdr", 0), 1, b"payload", 1)
    writer.finish()
    data = bytearray(stream.getvalue())
    start = data.index(b"payload") - 22 - 8  # the record's length, before channel, sequence and times
    assert int.from_bytes(data[start : start + 8], "little") == 22 + 7
    data[start : start + 8] = (10_000).to_bytes(8, "little")
    with pytest.raises(McapError):
        list(indexed.messages(io.BytesIO(bytes(data)), None))
