# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut off: always what is intact, never an accident."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from softgrip_bag import writer as writer_module
from softgrip_bag.errors import BagError
from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import attachments, bag_files, facts, read, topic_summaries
from softgrip_bag.repair import bags_in, is_being_written, is_broken, repair, repair_all
from softgrip_bag.writer import Attachment, BagWriter, Topic

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

HI = bytes.fromhex("00010000 03000000 686900")
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHUNKS = 6


@pytest.fixture
def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a bag of six chunks with one message each."""
    monkeypatch.setattr(writer_module, "FLUSH_INTERVAL", 0.0)
    bag = BagWriter(tmp_path / "whole", {"softgrip_machine": {"system": "test"}})
    bag.attach(Attachment("parameters/node.yaml", "application/yaml", b"{}"))
    bag.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    for index in range(CHUNKS):
        bag.write("/a", 1_000 + index, 500 + index, HI)
        bag.flush_if_due()
    return bag.close()


def cut(bag: Path, length: int, to: Path) -> Path:
    shutil.rmtree(to, ignore_errors=True)
    to.mkdir()
    (to / f"{to.name}_0.mcap").write_bytes(bag_files(bag)[0].read_bytes()[:length])
    return to


def test_cut_at_every_byte_gives_a_prefix_that_never_shrinks(whole: Path, tmp_path: Path) -> None:
    size = bag_files(whole)[0].stat().st_size
    before = 0
    for length in range(size + 1):
        found = list(read(cut(whole, length, tmp_path / "cut")))
        assert [m.received for m in found] == [1_000 + index for index in range(len(found))]
        assert all(m.data == HI for m in found)
        assert len(found) >= before
        before = len(found)
    assert before == CHUNKS


def test_cut_anywhere_is_repaired_to_a_bag_that_others_open(whole: Path, tmp_path: Path) -> None:
    size = bag_files(whole)[0].stat().st_size
    for length in random.Random(10).sample(range(size), 40):
        broken = cut(whole, length, tmp_path / "cut")
        readable = len(list(read(broken)))
        assert is_broken(broken)
        result = repair(broken)
        assert not is_broken(broken)
        assert result.messages == readable
        with bag_files(broken)[0].open("rb") as stream:
            assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == readable
        if readable:
            with AnyReader([broken]) as reader:
                assert sum(1 for _ in reader.messages()) == readable


def test_repair_keeps_attachments_facts_and_qos(whole: Path, tmp_path: Path) -> None:
    broken = cut(whole, bag_files(whole)[0].stat().st_size - 20, tmp_path / "cut")
    repair(broken)
    assert attachments(broken) == [Attachment("parameters/node.yaml", "application/yaml", b"{}")]
    assert facts(broken)["softgrip_machine"] == {"system": "test"}
    assert topic_summaries(broken) == topic_summaries(whole)


def test_a_flipped_byte_in_a_chunk_costs_that_chunk_only(whole: Path, tmp_path: Path) -> None:
    broken = cut(whole, 10**9, tmp_path / "cut")
    path = bag_files(broken)[0]
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    third = summary.chunk_indexes[2]
    data[third.chunk_start_offset + third.chunk_length - 2] ^= 0xFF
    path.write_bytes(data[:-1])
    result = repair(broken)
    assert result.bad_chunks == 1
    assert [m.received for m in read(broken)] == [1_000, 1_001, 1_003, 1_004, 1_005]


def test_a_bag_being_recorded_is_left_alone(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bags" / "now")
    assert is_being_written(tmp_path / "bags" / "now")
    assert list(repair_all(bags_in(tmp_path / "bags"))) == []
    with pytest.raises(BagError, match="being recorded"):
        repair(tmp_path / "bags" / "now")
    bag.close()
    assert not is_broken(tmp_path / "bags" / "now")


def test_repair_all_finishes_every_broken_bag_and_names_what_is_none(whole: Path, tmp_path: Path) -> None:
    root = tmp_path / "bags"
    root.mkdir()
    cut(whole, 10**9, root / "without_metadata")
    cut(whole, bag_files(whole)[0].stat().st_size // 2, root / "half")
    (root / "empty").mkdir()
    (root / "wrong").mkdir()
    (root / "wrong" / "wrong_0.mcap").write_bytes(b"no bag of any kind, just text in a file")
    results = list(repair_all(bags_in(root)))
    assert [type(result) for result in results] == [type(results[0]), type(results[0]), BagError]
    assert "expected MCAP" in str(results[2])
    assert list(read(root / "without_metadata"))
    assert (root / "half" / "metadata.yaml").is_file()
    assert len(list(repair_all(bags_in(root)))) == 1


def test_a_bag_of_zero_bytes_is_an_empty_bag(tmp_path: Path) -> None:
    (tmp_path / "zero").mkdir()
    (tmp_path / "zero" / "zero_0.mcap").touch()
    assert list(read(tmp_path / "zero")) == []
    assert repair(tmp_path / "zero").messages == 0
    assert list(read(tmp_path / "zero")) == []
