# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import contextlib
import time
import tracemalloc
from pathlib import Path

import pytest
import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from softgrip_bag.errors import BagError
from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import attachments, bag_files, facts, read, topic_summaries
from softgrip_bag.writer import Attachment, BagWriter, FileLimits, Topic

pytest.importorskip("mcap_ros2")
pytest.importorskip("rosbags")
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

#: std_msgs/String "hi" and "ho" as little-endian CDR.
HI = bytes.fromhex("00010000 03000000 686900")
HO = bytes.fromhex("00010000 03000000 686f00")
#: as rosidl computes it; rosbags checks it against its own computation
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    writer = BagWriter(tmp_path / "bag", {"softgrip_machine": {"system": "test"}})
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    writer.add_topic(
        Topic("/b", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(durability="transient_local", depth=1),))
    )
    writer.write("/a", 2_000, 1_500, HI)
    writer.write("/b", 1_000, 900, HO)
    writer.write("/a", 3_000, 2_500, HO)
    return writer.close()


def test_messages_come_back_unchanged_and_in_order_of_reception(bag: Path) -> None:
    messages = list(read(bag))
    assert [(m.topic, m.received, m.published, m.data) for m in messages] == [
        ("/b", 1_000, 900, HO),
        ("/a", 2_000, 1_500, HI),
        ("/a", 3_000, 2_500, HO),
    ]
    found = {topic.name: (topic.type_name, topic.latched) for topic in topic_summaries(bag)}
    assert found == {"/a": ("std_msgs/msg/String", False), "/b": ("std_msgs/msg/String", True)}


def test_rosbags_reads_the_folder(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        texts = [reader.deserialize(data, c.msgtype).data for c, _, data in reader.messages()]
    assert texts == ["ho", "hi", "ho"]


def test_mcap_ros2_support_reads_the_file(bag: Path) -> None:
    with bag_files(bag)[0].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        texts = [message.data for _, _, _, message in reader.iter_decoded_messages()]
    assert texts == ["ho", "hi", "ho"]


def test_metadata_is_version_nine_as_rosbag2_writes_it(bag: Path) -> None:
    text = (bag / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert "&id" not in text
    assert information["version"] == 9
    assert information["message_count"] == 3
    assert information["starting_time"]["nanoseconds_since_epoch"] == 1_000
    assert information["duration"]["nanoseconds"] == 2_000
    assert [t["message_count"] for t in information["topics_with_message_count"]] == [2, 1]
    assert information["topics_with_message_count"][1]["topic_metadata"]["offered_qos_profiles"][0]["durability"] == (
        "transient_local"
    )


def test_what_was_flushed_is_readable_without_the_end_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softgrip_bag.writer.FLUSH_INTERVAL", 0.0)
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    writer.write("/a", 1, 1, HI)
    writer.flush_if_due()
    found = []
    with bag_files(tmp_path / "bag")[0].open("rb") as stream, contextlib.suppress(McapError):
        for record in StreamReader(stream).records:
            if isinstance(record, Message):
                found.append(record.data)  # noqa: PERF401  what came before the error counts
    writer.close()
    assert found == [HI]


def test_an_existing_folder_is_not_overwritten(bag: Path) -> None:
    with pytest.raises(BagError, match="exists"):
        BagWriter(bag)


def test_a_folder_that_is_there_is_no_place_for_a_new_bag(tmp_path: Path) -> None:
    """Also where no file of it has the name of one of the bag's."""
    (tmp_path / "mine").mkdir()
    with pytest.raises(BagError, match="exists"):
        BagWriter(tmp_path / "mine")
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_missing_bag_and_a_file_that_is_no_mcap_are_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="found none"):
        list(read(tmp_path / "nothing"))
    wrong = tmp_path / "x.mcap"
    wrong.write_bytes(b"not an mcap file at all")
    with pytest.raises(BagError, match="expected MCAP"):
        list(read(wrong))


def test_times_that_nobody_can_write_are_taken_for_the_nearest_and_counted(tmp_path: Path) -> None:
    """MCAP has 64 bits without sign, ROS 64 with: what both can write is 0 .. 2^63 - 1."""
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    for received, published in ((5, -1), (-7, 6), (2**63, 2**64), (2**63 - 1, 0)):
        writer.write("/a", received, published, HI)
    assert writer.clamped_stamps == 3
    found = [(m.received, m.published) for m in read(writer.close())]
    assert sorted(found) == [(0, 6), (5, 0), (2**63 - 1, 0), (2**63 - 1, 2**63 - 1)]


def test_what_was_written_is_on_the_disk_a_quarter_of_a_second_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    writer.write("/a", 1, 1, HI)
    writer.flush_if_due()
    assert writer.stored.total() == 0, "not each message is a chunk of its own"
    now_s += 0.25
    writer.flush_if_due()
    assert writer.stored == {"/a": 1}
    writer.close()


def test_each_file_of_a_bag_explains_itself_and_the_metadata_knows_all_at_any_time(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", {"softgrip_machine": {"system": "test"}}, FileLimits(kept_files=2))
    writer.add_topic(Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))
    writer.attach(Attachment("a.yaml", "application/yaml", b"a: 1"))
    writer.add_fact("softgrip_fault", {"fault": "none"})
    for number in range(3):
        writer.write("/a", number, number, HI)
        writer.split()
        information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        assert information["message_count"] == min(number + 1, 1)
    writer.close()
    files = bag_files(tmp_path / "bag")
    assert [file.name for file in files] == ["bag_2.mcap", "bag_3.mcap"]
    for file in files:
        assert facts(file)["softgrip_fault"] == {"fault": "none"}
        assert facts(file)["softgrip_machine"] == {"system": "test"}
        assert [(a.name, a.data) for a in attachments(file)] == [("a.yaml", b"a: 1")]
    assert (writer.stored, writer.removed) == ({"/a": 1}, {"/a": 2})


def test_finished_files_keep_no_indexes_in_memory(tmp_path: Path) -> None:
    """An index of a chunk is some hundred bytes, four times a second for days."""
    writer = BagWriter(tmp_path / "bag")
    names = [f"/{number}" for number in range(30)]
    for name in names:
        writer.add_topic(Topic(name, "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),)))

    def fill_a_file() -> int:
        for number in range(50):
            for name in names:
                writer.write(name, number, number, HI)
            writer._file.flush()
        writer.split()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        after = [fill_a_file() for _ in range(10)]
        indexes = 5 * 50 * len(names) * 10  # [byte] of five files, as the MCAP specification has a channel's entry
        assert after[-1] - after[4] < indexes / 2
    finally:
        tracemalloc.stop()
        writer.close()
