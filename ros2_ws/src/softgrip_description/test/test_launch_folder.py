# SPDX-License-Identifier: Apache-2.0
"""A launch removes the folders that earlier launches have left, and no other."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from softgrip_description.commands.launch_folder import MIN_AGE_S, PREFIX, make_launch_folder


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def running() -> Iterator[Callable[[Path], None]]:
    """Return what starts a process that has a folder on its command line."""
    started: list[subprocess.Popen[bytes]] = []

    def start(folder: Path) -> None:
        command = "import time; print(flush=True); time.sleep(60)"
        process = subprocess.Popen([sys.executable, "-c", command, f"{folder}/p.yaml"], stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        process.stdout.readline()

    yield start
    for process in started:
        process.kill()
        process.communicate()


def age(folder: Path, age_s: float = MIN_AGE_S + 60.0) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "p.yaml").write_text("a: 1")
    os.utime(folder, (time.time() - age_s,) * 2)
    return folder


def test_only_old_folders_that_nobody_uses_are_removed(place: Path, running: Callable[[Path], None]) -> None:
    left, young, other = age(place / f"{PREFIX}left"), age(place / f"{PREFIX}young", 60.0), age(place / "other")
    used = age(place / f"{PREFIX}used")
    running(used)
    made = make_launch_folder()
    assert made.is_dir()
    assert made.parent == place
    assert not left.exists()
    assert young.exists()
    assert other.exists()
    assert (used / "p.yaml").exists()


def test_a_link_is_not_followed(place: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = age(tmp_path_factory.mktemp("elsewhere") / "kept")
    link = place / f"{PREFIX}link"
    link.symlink_to(elsewhere)
    os.utime(link, (time.time() - 2 * MIN_AGE_S,) * 2, follow_symlinks=False)
    make_launch_folder()
    assert (elsewhere / "p.yaml").exists()


def test_where_the_system_shows_no_processes_nothing_is_removed(
    place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("softgrip_description.commands.launch_folder._PROCESSES", tmp_path / "none")
    left = age(place / f"{PREFIX}left")
    make_launch_folder()
    assert left.exists()
