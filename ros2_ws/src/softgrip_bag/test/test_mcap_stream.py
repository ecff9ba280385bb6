# SPDX-License-Identifier: Apache-2.0
"""The summary of a file, by the library's own reader."""

from __future__ import annotations

import io

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Footer, SummaryOffset
from mcap.stream_reader import StreamReader

from softgrip_bag.mcap_stream import McapStream


def file_of(messages: int) -> bytes:
    """Two topics, chunks of some messages each, an attachment and metadata."""
    sink = io.BytesIO()
    stream = McapStream(sink, chunk_bytes=300)
    schema = stream.add_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channels = [stream.add_channel(topic, schema, {}) for topic in ("/a", "/b")]
    stream.add_metadata("facts", {"seed": "1"})
    stream.add_attachment("launch.yaml", "text/yaml", b"launch: []", 5)
    for number in range(messages):
        stream.add_message(channels[number % 2], 100 + number, 90 + number, b"%050d" % number)
    stream.finish()
    return sink.getvalue()


def test_the_summary_counts_what_was_written_and_finds_every_chunk() -> None:
    data = file_of(40)
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert (summary.statistics.message_count, summary.statistics.chunk_count) == (40, len(summary.chunk_indexes))
    assert summary.statistics.channel_message_counts == {1: 20, 2: 20}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (100, 139)
    assert len(summary.chunk_indexes) > 5
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == 0x06  # Chunk
    assert len(summary.attachment_indexes) == len(summary.metadata_indexes) == 1


def test_each_group_of_the_summary_lies_where_its_offset_says() -> None:
    """MCAP specification, "Summary Offset": groups of one opcode each, end to end from the summary's start."""
    data = file_of(40)
    footer = next(record for record in StreamReader(io.BytesIO(data)).records if isinstance(record, Footer))
    stream = io.BytesIO(data[footer.summary_offset_start :])
    offsets = []
    while stream.read(1) == b"\x0e":  # SummaryOffset
        size = int.from_bytes(stream.read(8), "little")
        offsets.append(SummaryOffset.read(ReadDataStream(io.BytesIO(stream.read(size)))))
    assert len(offsets) == 6
    at = footer.summary_start
    for offset in offsets:
        assert offset.group_start == at
        assert data[at] == offset.group_opcode
        at += offset.group_length
    assert at == footer.summary_offset_start
