# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import errno
import os
import random
import threading
import tracemalloc
from collections import Counter
from pathlib import Path

import pytest

from softgrip_bag import mcap_file
from softgrip_bag.arrivals import UNSUPPORTED, LossCounter
from softgrip_bag.errors import BagError
from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import RawMessage, bag_files, facts, read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.snapshot import Ring
from softgrip_bag.writer import BagWriter, FileLimits, Topic
from softgrip_testing.waiting import wait_until

HI = bytes.fromhex("00010000 03000000 686900")
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TOPIC = Topic("/a", "std_msgs/msg/String", HASH, "string data\n", (OfferedQos(),))


def bag_writer(folder: Path, limits: FileLimits | None = None) -> BagWriter:
    bag = BagWriter(folder, {"softgrip_machine": {"system": "test"}}, limits)
    bag.add_topic(TOPIC)
    return bag


def test_everything_put_is_written_in_order(tmp_path: Path) -> None:
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), 1_000_000)
    assert all(pipeline.put("/a", index, index, HI) for index in range(1000))
    assert [m.received for m in read(pipeline.close())] == list(range(1000))


def test_what_does_not_fit_is_counted_and_the_bag_says_so(tmp_path: Path) -> None:
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), 5 * len(HI))
    held, release = threading.Event(), threading.Event()

    def hold(_: BagWriter) -> None:
        held.set()
        release.wait(30.0)

    pipeline.call(hold)
    assert held.wait(30.0)
    assert [pipeline.put("/a", index, index, HI) for index in range(7)] == [True] * 5 + [False] * 2
    release.set()
    bag = pipeline.close(Counter({"/a": 1, "/b": 4}))
    assert len(list(read(bag))) == 5
    assert pipeline.dropped == {"/a": 2}
    assert facts(bag)["softgrip_dropped"] == {"/a": "3", "/b": "4"}


def test_a_full_disk_stops_the_recording_and_what_was_written_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softgrip_bag.writer.FLUSH_INTERVAL", 0.0)
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), 1_000_000)
    pipeline.put("/a", 1, 1, HI)
    pipeline.call(lambda bag: bag.flush_if_due()).result(30.0)
    real_write = mcap_file.os.write

    def half_then_full(descriptor: int, data: bytes) -> int:
        if len(data) > 10:
            return real_write(descriptor, data[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("softgrip_bag.mcap_file.os.write", half_then_full)
    pipeline.put("/a", 2, 2, HI)
    with pytest.raises(OSError, match="No space left"):
        pipeline.call(lambda bag: bag.split()).result(30.0)
    assert pipeline.put("/a", 3, 3, HI) is False
    assert pipeline.dropped["/a"] >= 1
    bag = pipeline.close()
    monkeypatch.undo()
    assert isinstance(pipeline.error, OSError)
    assert [m.received for m in read(bag)] == [1]
    assert is_broken(bag)
    assert repair(bag).lost_bytes == 0


def test_a_real_full_device_is_an_error_and_not_an_accident(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real_open = mcap_file.os.open
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")

    def open_full(path: Path, flags: int, *mode: int) -> int:
        return real_open(full, os.O_WRONLY) if str(path).endswith(".mcap") else real_open(path, flags, *mode)

    monkeypatch.setattr("softgrip_bag.mcap_file.os.open", open_full)
    with pytest.raises(BagError, match="No space left"):
        BagWriter(tmp_path / "bag")


def test_a_bag_that_has_less_than_it_was_given_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = bag_writer(tmp_path / "bag")
    write = bag.write
    monkeypatch.setattr(bag, "write", lambda *message: None if message[1] == 2 else write(*message))
    pipeline = Pipeline(bag, 1_000_000)
    for received in (1, 2, 3):
        assert pipeline.put("/a", received, received, HI)
    pipeline.close()
    assert isinstance(pipeline.error, BagError)
    assert "expected 3 messages in the bag, found 2" in str(pipeline.error)
    assert (pipeline.accepted, pipeline.dropped) == (2, {"/a": 1})


def test_what_waits_when_the_reserve_is_reached_is_dropped_and_whoever_waits_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = [10_000_000]
    monkeypatch.setattr("softgrip_bag.pipeline.free_bytes", lambda _: room[0])
    monkeypatch.setattr("softgrip_bag.pipeline.CHUNK_BYTES", len(HI))
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), 1_000_000, reserve_bytes=5_000_000)
    held, release = threading.Event(), threading.Event()

    def hold(_: BagWriter) -> None:
        held.set()
        release.wait(30.0)

    pipeline.put("/a", 1, 1, HI)
    pipeline.call(hold)
    assert held.wait(30.0)
    for received in (2, 3, 4):
        assert pipeline.put("/a", received, received, HI)
    waited = pipeline.call(BagWriter.split)
    room[0] = 4_999_999
    release.set()
    with pytest.raises(BagError, match="reserve_mb"):
        waited.result(30.0)
    assert not pipeline.put("/a", 5, 5, HI)
    bag = pipeline.close()
    assert not is_broken(bag)
    kept = [m.received for m in read(bag)]
    assert kept == [1, 2], "finished at the first look that found too little"
    assert (pipeline.accepted, pipeline.dropped) == (2, {"/a": 3})
    assert "reserve_mb" in str(pipeline.error)


def test_room_in_the_queue_comes_back_when_it_was_written(tmp_path: Path) -> None:
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), len(HI))
    for received in range(20):
        wait_until(lambda: pipeline.waiting_bytes == 0)
        assert pipeline.put("/a", received, received, HI)
    bag = pipeline.close()
    assert [m.received for m in read(bag)] == list(range(20))
    assert pipeline.peak_bytes == len(HI)


def test_what_was_put_is_on_the_disk_soon_without_anybodys_doing(tmp_path: Path) -> None:
    pipeline = Pipeline(bag_writer(tmp_path / "bag"), 1_000_000)
    pipeline.put("/a", 7, 7, HI)
    wait_until(lambda: [m.received for m in read(tmp_path / "bag")] == [7], "the message in the unfinished file")
    pipeline.close()


def test_a_bag_is_split_by_time_and_keeps_its_last_files(tmp_path: Path) -> None:
    bag = bag_writer(tmp_path / "bag", FileLimits(file_seconds=1e-6, kept_files=3))
    for index in range(10):
        bag.write("/a", index * 500, index, HI)
    assert bag.messages == 6
    bag.close()
    files = bag_files(tmp_path / "bag")
    assert [file.name for file in files] == ["bag_2.mcap", "bag_3.mcap", "bag_4.mcap"]
    assert [m.received for m in read(tmp_path / "bag")] == [2000, 2500, 3000, 3500, 4000, 4500]
    for file in files:
        assert [m.topic for m in read(file)] == ["/a", "/a"]
        assert facts(file)["softgrip_machine"] == {"system": "test"}


def test_a_bag_is_split_by_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("softgrip_bag.mcap_file.CHUNK_BYTES", 1)
    bag = bag_writer(tmp_path / "bag", FileLimits(file_bytes=1))
    for index in range(3):
        bag.write("/a", index, index, HI)
    bag.close()
    assert len(bag_files(tmp_path / "bag")) == 3
    assert len(list(read(tmp_path / "bag"))) == 3


def test_files_of_a_bag_are_read_in_the_order_they_were_written(tmp_path: Path) -> None:
    bag = bag_writer(tmp_path / "bag")
    for index in range(12):
        bag.write("/a", index, index, HI)
        bag.split()
    bag.close()
    assert [m.received for m in read(tmp_path / "bag")] == list(range(12))


def message(received: int, topic: str = "/a") -> RawMessage:
    return RawMessage(topic, "std_msgs/msg/String", received, received, HI)


def test_a_snapshot_begins_with_what_held_then_and_not_only_with_what_holds_now() -> None:
    ring = Ring(seconds=1e-6, capacity_bytes=10**6)
    for received in (0, 100, 900, 1500):
        ring.add(message(received, "/mode"), latched=True)
    ring.add(message(1600, "/a"), latched=False)
    assert [(m.topic, m.received) for m in ring.last()] == [
        ("/mode", 100),
        ("/mode", 900),
        ("/mode", 1500),
        ("/a", 1600),
    ]
    assert [(m.topic, m.received) for m in ring.last(2e-7)] == [("/mode", 900), ("/mode", 1500), ("/a", 1600)]


def test_the_ring_keeps_the_last_seconds_and_the_latched_ones() -> None:
    ring = Ring(seconds=1e-6, capacity_bytes=10**6)
    ring.add(message(0, "/mode"), latched=True)
    for received in range(0, 5000, 500):
        ring.add(message(received), latched=False)
    assert [(m.topic, m.received) for m in ring.last()] == [("/mode", 0), ("/a", 3500), ("/a", 4000), ("/a", 4500)]
    assert [m.received for m in ring.last(0.5e-6)] == [0, 4000, 4500]
    assert [m.topic for m in ring.latched()] == ["/mode"]


@pytest.mark.parametrize("size", [1, 1000])
def test_the_ring_stays_within_its_memory(size: int) -> None:
    """A stranger's many small messages take more beside their data than the data."""
    ring, count = Ring(seconds=1e6, capacity_bytes=1_000_000), 20_000
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for received in range(10**9, 10**9 + count):
            ring.add(RawMessage("/a", "std_msgs/msg/String", received, received + 1, bytes(size)), latched=False)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert 800_000 < grown < 1_050_000
    assert ring.last()[-1].received == 10**9 + count - 1


def test_gaps_between_sequence_numbers_are_losses_per_publisher() -> None:
    losses = LossCounter()
    for sequence, publisher in ((5, "p"), (6, "p"), (100, "q"), (9, "p"), (101, "q"), (8, "p"), (10, "p")):
        losses.add_sequence("/a", sequence, publisher)
    losses.add_sequence("/b", None, None)
    losses.add_sequence("/b", UNSUPPORTED, None)
    losses.add_sequence("/b", 4, None)
    assert losses.lost == {"/a": 1}  # 7 never came; 8 was late


def test_a_message_that_comes_very_late_is_lost() -> None:
    losses = LossCounter()
    for sequence in (1, 3, 5000, 4999, 2):
        losses.add_sequence("/a", sequence, "p")
    assert losses.lost == {"/a": 4999 - 3 - 1 + 1}


def test_late_numbers_are_found_within_gaps_and_only_once() -> None:
    """Against a plain set of what has come, with numbers that come up to 30 places late, some twice, some never."""
    chance = random.Random(4)
    numbers = [number for number in range(1, 4000) if chance.random() > 0.02]
    sent = sorted(numbers, key=lambda number: number + chance.uniform(0.0, 30.0))
    losses, come = LossCounter(), set()
    for number in sent:
        losses.add_sequence("/a", number, "one")
        if chance.random() < 0.05:
            losses.add_sequence("/a", chance.choice([*sent[:1], number]), "one")
        come.add(number)
    everything = set(range(sent[0], max(sent) + 1))
    assert losses.lost["/a"] == len(everything - come)


def test_a_number_that_is_too_far_ahead_is_forged_and_hides_no_loss() -> None:
    losses = LossCounter()
    for number in (1, 2, 2**63 - 1, 3, 6, 2_000_000, 7):
        losses.add_sequence("/a", number, "one")
    assert losses.lost == {"/a": 2}


def test_forged_publishers_take_little_memory_and_the_real_one_is_still_counted() -> None:
    losses = LossCounter()
    tracemalloc.start()
    for number in range(1, 60_001):
        losses.add_sequence("/forged", number * 1000, number % 20_000)
        if number % 20:
            losses.add_sequence("/real", number, "real")
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert held < 4_000_000
    assert losses.lost["/real"] == 60_000 // 20 - 1  # the last gap has no end yet
