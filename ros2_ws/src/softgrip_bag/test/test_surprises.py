# SPDX-License-Identifier: Apache-2.0
"""Whatever comes to the writer, nothing is lost in silence."""

from __future__ import annotations

import errno
import os
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag import salvage
from softgrip_bag.errors import BagError, RecordRefusedError
from softgrip_bag.mcap_file import McapFile
from softgrip_bag.mcap_stream import MAX_ID, McapStream
from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import read
from softgrip_bag.repair import is_broken
from softgrip_bag.writer import BagWriter, Topic

HI = bytes.fromhex("00010000 03000000 686900")


def topic(name: str) -> Topic:
    return Topic(name, "std_msgs/msg/String", "", "string data\n", (OfferedQos(),))


@pytest.fixture
def pipeline(tmp_path: Path) -> Pipeline:
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic(topic("/a"))
    return Pipeline(bag, 1_000_000)


def test_stamps_that_cannot_be_written_are_taken_for_the_nearest_and_counted(pipeline: Pipeline) -> None:
    stamps = [-1, -(2**63), 2**63, 2**64, 2**200, 0, 5, 2**63 - 1]
    for stamp in stamps:
        assert pipeline.put("/a", 10, stamp, HI)
        assert pipeline.put("/a", stamp, 10, HI)
    bag = pipeline.close()
    assert pipeline.error is None
    assert pipeline.clamped_stamps == 2 * 5
    found = list(read(bag))
    assert len(found) == pipeline.accepted == 2 * len(stamps)
    expected = {0, 5, 10, 2**63 - 1}
    assert {m.published for m in found} == {m.received for m in found} == expected


def test_a_message_of_no_topic_is_dropped_and_the_rest_goes_on(pipeline: Pipeline) -> None:
    for name in ("/a", "/nobody", "/a"):
        pipeline.put(name, 1, 1, HI)
    assert len(list(read(pipeline.close()))) == 2
    assert pipeline.error is None
    assert pipeline.accepted == 2
    assert pipeline.dropped == {"/nobody": 1}


def test_one_topic_more_than_a_file_can_have_is_refused_and_the_rest_goes_on(
    pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softgrip_bag.mcap_stream.MAX_ID", 2)
    pipeline.call(lambda bag: bag.add_topic(topic("/b"))).result(30.0)
    with pytest.raises(RecordRefusedError, match="at most 2 channels"):
        pipeline.call(lambda bag: bag.add_topic(topic("/c"))).result(30.0)
    for name in ("/a", "/b", "/c"):
        pipeline.put(name, 1, 1, HI)
    pipeline.call(lambda bag: bag.split()).result(30.0)
    assert {message.topic for message in read(pipeline.close())} == {"/a", "/b"}
    assert pipeline.error is None
    assert pipeline.dropped == {"/c": 1}


def test_ids_end_where_sixteen_bits_do() -> None:
    class Nowhere:
        def write(self, data: bytes) -> int:
            return len(data)

        def tell(self) -> int:
            return 0

    stream = McapStream(Nowhere(), 1)
    schema = stream.add_schema("s", "ros2msg", b"")
    ids = [stream.add_channel(f"/{number}", schema, {}) for number in range(MAX_ID)]
    assert ids[-1] == 65535
    stream.add_message(ids[-1], 1, 1, HI)
    with pytest.raises(RecordRefusedError):
        stream.add_channel("/more", schema, {})


def break_work(_: BagWriter) -> None:
    raise ZeroDivisionError("on purpose")


def test_an_error_of_any_kind_is_seen_and_answers_everybody_who_waits(pipeline: Pipeline) -> None:
    pipeline.put("/a", 1, 1, HI)
    with pytest.raises(ZeroDivisionError):
        pipeline.call(break_work).result(30.0)
    pipeline._thread.join(30.0)
    assert isinstance(pipeline.error, ZeroDivisionError)
    with pytest.raises(ZeroDivisionError):
        pipeline.call(BagWriter.split).result(30.0)
    assert not pipeline.put("/a", 2, 2, HI)
    found = Counter(message.topic for message in read(pipeline.close()))
    assert found + pipeline.dropped == {"/a": 2}


def test_a_thread_that_is_gone_takes_nothing(pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even the guard around the thread is trusted."""
    monkeypatch.setattr(pipeline, "_fail", lambda _: None)
    pipeline.call(break_work)
    pipeline._thread.join(30.0)
    assert not pipeline.put("/a", 1, 1, HI)
    with pytest.raises(BagError, match="has ended"):
        pipeline.call(BagWriter.split).result(30.0)
    pipeline._bag.abandon()


def test_a_summary_that_does_not_say_all_is_an_error(pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    real = salvage.footer_counts
    monkeypatch.setattr(salvage, "footer_counts", lambda path: real(path) - Counter({"/a": 1}))
    pipeline.put("/a", 1, 1, HI)
    pipeline.put("/a", 2, 2, HI)
    pipeline.close()
    assert isinstance(pipeline.error, BagError)
    assert "expected 2 messages in the file's summary, found 1" in str(pipeline.error)


def test_a_message_that_the_bag_swallows_is_an_error(pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    real: Callable[..., None] = BagWriter.write

    def swallow(bag: BagWriter, name: str, *others: Any) -> None:
        if others[0] != 2:
            real(bag, name, *others)

    monkeypatch.setattr(BagWriter, "write", swallow)
    for time in (1, 2, 3):
        pipeline.put("/a", time, time, HI)
    bag = pipeline.close()
    assert "expected 3 messages in the bag, found 2" in str(pipeline.error)
    assert not is_broken(bag)
    assert pipeline.dropped == {"/a": 1}


def test_a_file_that_is_closed_closes_nobody_elses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system gives a descriptor's number to the next file at once, also when close(2) answered an error."""
    file = McapFile(tmp_path / "x.mcap")
    file.open()
    real = os.close

    def close_and_complain(descriptor: int) -> None:
        real(descriptor)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(os, "close", close_and_complain)
        with pytest.raises(OSError, match="Input/output"):
            file.finish()
    with tempfile.TemporaryFile() as another:
        another.write(b"mine")
        another.flush()
        file.abandon()
        assert os.fstat(another.fileno()).st_size == 4
