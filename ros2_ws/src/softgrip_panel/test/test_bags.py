# SPDX-License-Identifier: Apache-2.0
"""The bags of a folder: what is listed, the room that is left, downloads, reports and replays."""

from __future__ import annotations

import asyncio
import os
import shutil
from pathlib import Path

import pytest

from softgrip_panel.errors import PanelError
from softgrip_panel.model.bags import REPLAYED, BagFolder, BagJobs

#: Stands in for `ros2`: writes down what it was asked for, and does what a report or a replay would.
ROS2 = """#!/bin/sh
echo "$@" >> "$SAID"
case "$3" in
report) [ -e "$SAID.broken" ] && { echo "no messages in it"; exit 2; }
        echo "<html><svg></svg></html>" > "$6" ;;
replay) echo "replaying"; echo '{"messages": 120, "largest": 0.0, "outputs": {"a": 1}}'; [ ! -e "$SAID.differs" ] ;;
esac
"""


@pytest.fixture
def folder(tmp_path: Path) -> BagFolder:
    for number, name in enumerate(("old", "new")):
        bag = tmp_path / "bags" / name
        bag.mkdir(parents=True)
        (bag / f"{name}_0.mcap").write_bytes(b"x" * (100 + number))
        (bag / "metadata.yaml").write_bytes(b"y" * 10)
        for file in bag.iterdir():
            os.utime(file, (1000.0 + number, 1000.0 + number))
    return BagFolder(tmp_path / "bags")


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file in which the stand-in for `ros2` writes what it was asked for."""
    program = tmp_path / "bin" / "ros2"
    program.parent.mkdir()
    program.write_text(ROS2)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("SAID", str(tmp_path / "said"))
    return tmp_path / "said"


def test_bags_are_listed_newest_first_with_their_size(folder: BagFolder) -> None:
    new, old = folder.bags()
    assert (new.name, new.size, new.files) == ("new", 111, (("metadata.yaml", 10), ("new_0.mcap", 101)))
    assert (old.name, old.size, old.at_s) == ("old", 110, 1000.0)
    assert not new.has_report


def test_what_is_no_bag_is_not_listed(folder: BagFolder, tmp_path: Path) -> None:
    assert folder.root is not None
    (folder.root / "empty").mkdir()
    (folder.root / "a file.mcap").write_bytes(b"x")
    (folder.root / "linked").mkdir()
    (folder.root / "linked" / "passwd").symlink_to("/etc/passwd")
    (folder.root / "..hidden").mkdir()
    assert [bag.name for bag in folder.bags()] == ["new", "old"]


def test_the_room_left_is_the_disks(folder: BagFolder) -> None:
    free = folder.free_bytes()
    assert free is not None
    assert free == pytest.approx(shutil.disk_usage(folder.root or "/").free, rel=0.05)
    assert BagFolder(None).free_bytes() is None
    assert BagFolder(None).bags() == ()


def test_a_file_of_a_bag_can_be_fetched_and_nothing_else(folder: BagFolder) -> None:
    assert folder.file("new", "new_0.mcap").read_bytes() == b"x" * 101
    for bag, name in (("new", "old_0.mcap"), ("new", "../old/old_0.mcap"), ("..", "said"), ("gone", "gone_0.mcap")):
        with pytest.raises(PanelError, match="expected a file of a bag in the list"):
            folder.file(bag, name)


def test_a_report_is_made_beside_its_bag(folder: BagFolder, said: Path) -> None:
    jobs = BagJobs(folder)
    assert jobs.find("new", "report") is None
    done = asyncio.run(jobs.run("new", "report"))
    assert (done.is_running, done.message) == (False, "")
    assert said.read_text() == f"run softgrip_bag report {folder.root}/new -o {folder.root}/new-report.html\n"
    assert "<svg>" in folder.report("new").read_text()
    assert [bag.has_report for bag in folder.bags()] == [True, False]


def test_a_report_that_cannot_be_made_says_why(folder: BagFolder, said: Path) -> None:
    said.with_name("said.broken").touch()
    assert "no messages in it" in asyncio.run(BagJobs(folder).run("new", "report")).message
    assert not folder.report("new").exists()


@pytest.mark.parametrize("differs", [False, True])
def test_a_replay_gives_its_verdict_with_its_figures(folder: BagFolder, said: Path, *, differs: bool) -> None:
    if differs:
        said.with_name("said.differs").touch()
    message = asyncio.run(BagJobs(folder).run("old", "replay")).message
    assert message == f"{'differs' if differs else 'identical'}: messages: 120, largest: 0.0"
    assert f"replay --through {REPLAYED} --json {folder.root}/old" in said.read_text()


def test_jobs_wait_for_their_turn_and_one_is_not_begun_twice(folder: BagFolder, said: Path) -> None:
    async def all_at_once() -> list[str]:
        jobs = BagJobs(folder)
        first = asyncio.create_task(jobs.run("new", "report"))
        await asyncio.sleep(0)
        again = await jobs.run("new", "report")
        assert again.is_running
        other = await jobs.run("old", "replay")
        await first
        return [other.message, (await jobs.run("new", "replay")).message]

    assert all(one.startswith("identical") for one in asyncio.run(all_at_once()))
    asked = [line.split()[2:4] for line in said.read_text().splitlines()]
    assert [one[0] for one in asked] == ["report", "replay", "replay"]


def test_no_job_of_a_bag_that_is_not_there(folder: BagFolder, said: Path) -> None:
    assert "expected a bag of the list" in asyncio.run(BagJobs(folder).run("gone", "replay")).message
    assert not said.exists()


def test_without_a_program_the_job_says_so(folder: BagFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "No such file" in asyncio.run(BagJobs(folder).run("new", "report")).message
