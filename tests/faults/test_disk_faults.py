# SPDX-License-Identifier: Apache-2.0
"""Each write of friction rig and zero store fails: an error, and what was there before or what was meant, whole."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import io
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_driver.errors import ConfigurationError, JournalError
from softgrip_driver.rig.journal import MeasuredPoint, PlanJournal, Request
from softgrip_driver.rig.pulley import Pulley, read_pulley, write_pulley
from softgrip_driver.tendon.zero_store import StoredZero, ZeroStore
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.store import ModelStore

CODES = [errno.EIO, errno.ENOSPC, errno.EROFS]
MODEL = dataclasses.replace(published(published_ids()[0]), id="measured")
REFUSED = (OSError, ConfigurationError, JournalError)


def zero(number: int) -> dict[str, StoredZero]:
    return {"index": StoredZero("device", 0.01, 1, 0.001 * number, 3, "2026-01-01T00:00:00+00:00", number)}


class Files:
    """What rig and driver keep in a folder, written and read back."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def activate(self, number: int) -> None:
        ModelStore(self.folder / "models").activate(published_ids()[number])

    def active(self) -> Any:
        return ModelStore(self.folder / "models").active

    def pulley(self, number: int) -> None:
        write_pulley(self.folder, Pulley(1.0 + 0.1 * number, 0.01))

    def pulley_kept(self) -> Any:
        return read_pulley(self.folder)

    def zero(self, number: int) -> None:
        ZeroStore(self.folder / "zeros.yaml").save(zero(number))

    def zero_kept(self) -> Any:
        return ZeroStore(self.folder / "zeros.yaml").load()


WRITERS: dict[str, tuple[Callable[[Files, int], None], Callable[[Files], Any]]] = {
    "active model": (Files.activate, Files.active),
    "pulley": (Files.pulley, Files.pulley_kept),
    "zeros": (Files.zero, Files.zero_kept),
}


def raises_refused(work: Callable[[], None]) -> bool:
    try:
        work()
    except REFUSED:
        return True
    return False


class FailingCalls:
    """The k-th call that writes below a folder fails."""

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path, failing: int, code: int) -> None:
        self.count = 0
        self._folder, self._failing, self._code = str(folder), failing, code
        for name in ("open", "fsync", "replace", "mkdir"):
            patch.setattr(os, name, self._guarded(getattr(os, name)))
        patch.setattr(os, "fdopen", self._fdopen)

    def _check(self, place: Any) -> None:
        if isinstance(place, int):
            place = Path(f"/proc/self/fd/{place}").readlink()
        if str(place).startswith(self._folder):
            self.count += 1
            if self.count == self._failing:
                raise OSError(self._code, os.strerror(self._code))

    def _guarded(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def guarded(*arguments: Any, **options: Any) -> Any:
            self._check(arguments[0])
            return call(*arguments, **options)

        return guarded

    def _fdopen(self, descriptor: int, _mode: str) -> Any:
        calls = self

        class Raw(io.FileIO):
            def write(self, data: Any) -> int:
                calls._check(descriptor)
                return super().write(data)

        return io.BufferedRandom(Raw(descriptor, "r+"))


@pytest.mark.parametrize("code", CODES, ids=errno.errorcode.get)
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_rig_and_driver_is_the_old_or_the_new_one_whichever_write_fails(
    tmp_path: Path, name: str, code: int
) -> None:
    write, read = WRITERS[name]
    files = Files(tmp_path)
    write(files, 1)
    new = read(files)
    write(files, 0)
    old = read(files)
    assert old != new
    with pytest.MonkeyPatch.context() as patch:
        whole = FailingCalls(patch, tmp_path, -1, code)
        write(files, 0)
    refusals = 0
    for failing in range(1, whole.count + 1):
        write(files, 0)
        with pytest.MonkeyPatch.context() as patch:
            FailingCalls(patch, tmp_path, failing, code)
            is_refused = raises_refused(lambda: write(files, 1))
        refusals += is_refused
        assert read(files) in ((old, new) if is_refused else (new,))
        assert not [path for path in tmp_path.rglob(".*") if path.is_file()]
    assert refusals >= 6  # two opens, write, fsync, rename, fsync; a mkdir of a folder that is there may fail


@pytest.mark.parametrize("code", CODES, ids=errno.errorcode.get)
def test_a_measured_model_is_kept_whole_or_not_at_all(tmp_path: Path, code: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        whole = FailingCalls(patch, tmp_path, -1, code)
        ModelStore(tmp_path / "whole").add(MODEL)
    for failing in range(1, whole.count + 1):
        folder = tmp_path / f"models{failing}"
        with pytest.MonkeyPatch.context() as patch:
            FailingCalls(patch, tmp_path, failing, code)
            is_refused = raises_refused(lambda folder=folder: ModelStore(folder).add(MODEL))
        store = ModelStore(folder)
        models, problems = store.readable()
        assert problems == []
        measured = {model.id for model in models} - set(published_ids())
        assert measured <= {"measured"}
        assert is_refused or measured == {"measured"}
        assert store.active == ""


def accept(journal: PlanJournal, index: int) -> None:
    journal.accept(MeasuredPoint(index, 1.0, 0.1, 1.0, 1.2))


def fill(disk: Path) -> Callable[[], None]:
    with (disk / "filler").open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while stream.write(bytes(4096)):
            pass
    return (disk / "filler").unlink


def make_read_only(disk: Path) -> Callable[[], None]:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    return lambda: subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True) and None


@pytest.mark.parametrize("fail", [fill, make_read_only], ids=["full", "read-only"])
def test_on_a_real_disk_that_is_full_or_read_only_everything_stays_and_goes_on_afterwards(
    mounted_disk: Path, fail: Callable[[Path], Callable[[], None]]
) -> None:
    files = Files(mounted_disk)
    for write, _ in WRITERS.values():
        write(files, 0)
    before = [read(files) for _, read in WRITERS.values()]
    journal = PlanJournal.create(mounted_disk / "plans", "p", Request("quick"))
    accept(journal, 0)
    restore = fail(mounted_disk)
    for write, _ in WRITERS.values():
        with pytest.raises(REFUSED):
            write(files, 1)
    with pytest.raises(REFUSED):
        ModelStore(mounted_disk / "models").add(MODEL)
    lines = 1
    while not raises_refused(lambda number=lines: accept(journal, number)):  # the file's last block may have room
        lines += 1
        assert lines < 1000
    assert [read(files) for _, read in WRITERS.values()] == before
    restore()
    kept = PlanJournal.read(mounted_disk / "plans" / "p.jsonl")
    assert sorted(kept.points) == list(range(lines))
    accept(kept, 5000)
    assert 5000 in PlanJournal.read(mounted_disk / "plans" / "p.jsonl").points
    for write, read in WRITERS.values():
        write(files, 1)
        assert read(files) not in before
