# SPDX-License-Identifier: Apache-2.0
"""What counts as written is on the disk: the last thing that is done to a file is to write it through."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from softgrip_bag import writer as writer_module
from softgrip_bag.offers import OfferedQos
from softgrip_bag.writer import BagWriter, Topic

HI = bytes.fromhex("00010000 03000000 686900")


def test_every_flush_and_the_end_write_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    write: Callable[..., int] = os.write
    sync: Callable[[int], None] = os.fdatasync

    def watch_write(descriptor: int, data: memoryview) -> int:
        done.append("write")
        return write(descriptor, data)

    def watch_sync(descriptor: int) -> None:
        done.append("sync")
        sync(descriptor)

    monkeypatch.setattr(os, "write", watch_write)
    monkeypatch.setattr(os, "fdatasync", watch_sync)
    monkeypatch.setattr(writer_module, "FLUSH_INTERVAL", 0.0)
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic(Topic("/a", "std_msgs/msg/String", "", "string data\n", (OfferedQos(),)))
    for number in range(3):
        done.clear()
        bag.write("/a", 1_000 + number, 500, HI)
        bag.flush_if_due()
        assert done[-1] == "sync", "a second of a recording would be lost"
        assert "write" in done
    done.clear()
    bag.close()
    assert done[-1] == "sync", "the end of a recording would be lost"
