# SPDX-License-Identifier: Apache-2.0
"""A disk that fills up: the recording ends while there is room left for the others."""

from __future__ import annotations

import random
import shutil
import threading
from collections import Counter
from pathlib import Path

import pytest

from softgrip_bag.errors import DiskError
from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline, free_bytes
from softgrip_bag.reader import read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.writer import BagWriter, Topic

TOPIC = Topic("/a", "std_msgs/msg/String", "", "string data\n", (OfferedQos(),))
#: Messages that nothing packs tighter.
NOISE = [random.Random(number).randbytes(100_000) for number in range(200)]


def fill(disk: Path, reserve: int, monkeypatch: pytest.MonkeyPatch) -> Pipeline:
    """Offer 200 messages of 100 kB, two and a half times what the disk has, all before the first is written."""
    monkeypatch.setattr("softgrip_bag.writer.FLUSH_INTERVAL", 1e-3)
    bag = BagWriter(disk / "bag")
    bag.add_topic(TOPIC)
    pipeline = Pipeline(bag, 100_000_000, reserve)
    filled = threading.Event()
    pipeline.call(lambda _: filled.wait(60.0))
    for number, noise in enumerate(NOISE):
        pipeline.put("/a", number, number, noise)
    filled.set()
    pipeline.close()
    return pipeline


def test_a_recording_ends_before_the_reserve_is_used(small_disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = fill(small_disk, 4_000_000, monkeypatch)
    assert isinstance(pipeline.error, DiskError)
    assert "reserve_mb" in str(pipeline.error)
    assert not is_broken(pipeline.folder)
    # what was begun when the reserve was met is finished: at most two chunks
    assert free_bytes(small_disk) > 4_000_000 - 2_500_000
    found = Counter(message.topic for message in read(pipeline.folder))
    assert 20 < found.total() < 60
    assert pipeline.accepted == found.total()
    assert pipeline.dropped == {"/a": 200 - found.total()}
    assert not pipeline.put("/a", 1, 1, b"")


def test_without_a_reserve_a_full_disk_loses_no_count(small_disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = fill(small_disk, 0, monkeypatch)
    assert isinstance(pipeline.error, OSError)
    assert is_broken(pipeline.folder)
    found = Counter(message.topic for message in read(pipeline.folder))
    assert found.total() > 60
    assert found + pipeline.dropped == {"/a": 200}
    monkeypatch.undo()
    there = shutil.copytree(pipeline.folder, small_disk.parent / "elsewhere")
    assert repair(there).messages == found.total()
