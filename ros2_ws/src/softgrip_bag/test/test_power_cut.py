# SPDX-License-Identifier: Apache-2.0
"""What a power cut leaves of a bag, by the model of fsync(2) in the suite's conftest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.writer import BagWriter, Topic

HI = bytes.fromhex("00010000 03000000 686900")
TOPIC = Topic("/a", "std_msgs/msg/String", "", "string data\n", (OfferedQos(),))


def readable(outcome: dict[str, bytes], place: Path) -> list[int]:
    """Put down what is left, repair it and return the messages' times."""
    for name, content in outcome.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(content)
    bag = place / "bag"
    if is_broken(bag):
        repair(bag)
    return [message.received for message in read(bag)]


def test_what_was_flushed_outlives_a_power_cut(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    volatile_disk: Callable[[], Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("softgrip_bag.writer.FLUSH_INTERVAL", 0.0)
    disk = volatile_disk()
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic(TOPIC)
    times: list[int] = []
    for time in range(1, 4):
        bag.write("/a", time, time, HI)
        bag.flush_if_due()
        times.append(time)
        for outcome in disk.after_power_cut():
            assert readable(outcome, tmp_path_factory.mktemp("left")) == times
        if time == 2:
            bag.split()
    bag.close()
    for outcome in disk.after_power_cut():
        place = tmp_path_factory.mktemp("left")
        assert set(outcome) == {"bag/bag_0.mcap", "bag/bag_1.mcap", "bag/metadata.yaml"}
        assert readable(outcome, place) == times


def test_a_power_cut_during_a_repair_loses_nothing(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, volatile_disk: Callable[[], Any]
) -> None:
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic(TOPIC)
    for time in range(1, 4):
        bag.write("/a", time, time, HI)
    path = next(bag.close().glob("*.mcap"))
    path.write_bytes(path.read_bytes()[:-20])
    disk = volatile_disk()
    repair(tmp_path / "bag")
    assert disk.moments
    for outcomes in [*disk.moments, disk.after_power_cut()]:
        for outcome in outcomes:
            kept = {name: content for name, content in outcome.items() if not name.endswith(".new")}
            assert readable(kept, tmp_path_factory.mktemp("left")) == [1, 2, 3]
