# SPDX-License-Identifier: Apache-2.0
"""Each call of the thread that writes fails once: what was offered is what is read back and what is counted as dropped.

As SQLite is tested (sqlite.org/testing.html, "Anomaly testing"): the calls are counted in a run where all goes well,
then the first fails, the second, and so on. `make test` fails the first and the last call of each place in the code,
`make crash` every call (SOFTGRIP_EVERY_CALL=1).
"""

from __future__ import annotations

import errno
import os
import shutil
import struct
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag import mcap_file, mcap_stream, metadata, writer
from softgrip_bag.errors import BagError
from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.writer import Attachment, BagWriter, FileLimits, Topic
from softgrip_model import durable
from softgrip_testing.failing_calls import looking_at_calls

HI = bytes.fromhex("00010000 03000000 686900")
TOPICS = [Topic(name, "std_msgs/msg/String", "", "string data\n", (OfferedQos(),)) for name in ("/a", "/b", "/late")]
OFFERED = Counter({"/a": 9, "/b": 6, "/late": 2, "/unknown": 1})
#: What is called by these is made to fail.
WRITER = [writer, mcap_file, mcap_stream, metadata, durable]
FAILURES: tuple[Callable[[], Exception], ...] = (
    lambda: OSError(errno.EIO, os.strerror(errno.EIO)),
    MemoryError,
    lambda: KeyError("on purpose"),
    lambda: struct.error("on purpose"),
)


@pytest.fixture(autouse=True)
def _no_flush_by_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each run has the same calls: nothing is flushed because a busy computer took long, only by `flush`."""
    monkeypatch.setattr("softgrip_bag.writer.FLUSH_INTERVAL", 1e6)


def flush(bag: BagWriter) -> None:
    bag._flushed = -1e9
    bag.flush_if_due()


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory where the system has one: thousands of bags are made durable here."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as made:
        yield Path(made)


def record(folder: Path, before_writing: Callable[[], None] = lambda: None) -> tuple[Pipeline, list[Future[Any]]]:
    """Record a little with all that a bag can do; everything is queued before the thread does the first of it."""
    bag = BagWriter(folder, {"softgrip_machine": {"system": "test"}}, FileLimits(kept_files=2))
    for topic in TOPICS[:2]:
        bag.add_topic(topic)
    pipeline = Pipeline(bag, 1_000_000)
    filled, ready = threading.Event(), threading.Event()

    def wait(_: BagWriter) -> None:
        ready.set()
        filled.wait(60.0)
        before_writing()

    waited: list[Future[Any]] = [pipeline.call(wait)]
    assert ready.wait(60.0)

    def put(topic: str, count: int) -> None:
        for number in range(count):
            pipeline.put(topic, 1_000 + number, 1_000 + number, HI)

    put("/a", 4)
    put("/b", 4)
    put("/unknown", 1)
    waited.append(pipeline.call(flush))
    waited.append(pipeline.call(lambda bag: bag.attach(Attachment("x.yaml", "application/yaml", b"a: 1"))))
    waited.append(pipeline.call(BagWriter.split))
    waited.append(pipeline.call(lambda bag: bag.add_topic(TOPICS[2])))
    put("/a", 3)
    put("/late", 2)
    waited.append(pipeline.call(BagWriter.split))
    put("/a", 2)
    put("/b", 2)
    filled.set()
    pipeline.close()
    return pipeline, waited


def check_that_nothing_is_missing(pipeline: Pipeline, waited: list[Future[Any]]) -> None:
    """Offered = read back + deleted with old files + dropped, topic by topic; a success is whole."""
    assert all(future.done() for future in waited)
    if is_broken(pipeline.folder):
        assert pipeline.error is not None
        repair(pipeline.folder)
        assert not is_broken(pipeline.folder)
    found = Counter(message.topic for message in read(pipeline.folder))
    assert found + pipeline.removed + pipeline.dropped == OFFERED
    assert (found + pipeline.removed).total() == pipeline.accepted
    if pipeline.error is None:
        assert found == {"/a": 5, "/b": 2, "/late": 2}
        assert pipeline.removed == {"/a": 4, "/b": 4}
        assert pipeline.dropped == {"/unknown": 1}
        assert not any(future.exception() for future in waited)


def test_without_a_failure_nothing_is_missing(tmp_path: Path) -> None:
    pipeline, waited = record(tmp_path / "bag")
    assert pipeline.error is None
    check_that_nothing_is_missing(pipeline, waited)


class Counted:
    """Counts the calls of the writer on one thread, and fails one of them."""

    def __init__(self, failing: int = -1) -> None:
        self.failed = ""
        #: where each call stood, in their order: file, line, what was called
        self.places: list[tuple[str, int, str]] = []
        self._failing = failing
        self._thread = 0

    @property
    def count(self) -> int:
        return len(self.places)

    def first_and_last_of_each_place(self) -> list[int]:
        """Numbers of calls, from 1."""
        numbered = dict(enumerate(self.places, 1))
        first = {place: number for number, place in reversed(numbered.items())}
        last = {place: number for number, place in numbered.items()}
        return sorted({*first.values(), *last.values()})

    def begin(self) -> None:
        """Count the calls of this thread."""
        self._thread = threading.get_ident()

    def see(self, file: str, line: int, name: str) -> None:
        if threading.get_ident() != self._thread:
            return
        self.places.append((file, line, name))
        if self.count == self._failing:
            self.failed = f"{name}, called in {Path(file).name}:{line}"
            failure = FAILURES[self._failing % len(FAILURES)]
            raise failure()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_exception_at_every_call_of_the_writer_loses_no_count(folder: Path) -> None:
    whole = Counted()
    with looking_at_calls(WRITER, whole.see):
        record(folder / "whole", whole.begin)
    assert whole.count > 500
    every = range(1, whole.count + 1)
    for failing in every if os.environ.get("SOFTGRIP_EVERY_CALL") else whole.first_and_last_of_each_place():
        counted = Counted(failing)
        with looking_at_calls(WRITER, counted.see):
            pipeline, waited = record(folder / f"bag{failing}", counted.begin)
        assert counted.failed
        try:
            check_that_nothing_is_missing(pipeline, waited)
        except (AssertionError, BagError) as error:
            raise AssertionError(f"call {failing}, {counted.failed}, {pipeline.error!r}") from error
        shutil.rmtree(pipeline.folder)


class FailingDisk:
    """Fails the system calls that write, from the k-th on: once, or ever after; a failing write takes half first."""

    CALLS = ("open", "write", "fdatasync", "fsync", "ftruncate", "replace", "unlink", "mkdir", "close")

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path, failing: int, code: int, *, forever: bool) -> None:
        self.count = 0
        self._folder, self._failing, self._code, self._forever = str(folder), failing, code, forever
        self._real = {name: getattr(os, name) for name in self.CALLS}
        for name in self.CALLS:
            patch.setattr(os, name, self._call(name))

    def _call(self, name: str) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if not self._is_ours(arguments[0]):
                return self._real[name](*arguments, **options)
            self.count += 1
            if self.count != self._failing and not (self._forever and self.count > self._failing > 0):
                return self._real[name](*arguments, **options)
            if name == "write":
                self._real[name](arguments[0], arguments[1][: len(arguments[1]) // 2])
            if name == "close":  # the descriptor is gone all the same, close(2)
                self._real[name](*arguments)
            raise OSError(self._code, os.strerror(self._code))

        return call

    def _is_ours(self, place: Any) -> bool:
        if threading.current_thread().name != "bag writer":
            return False
        if isinstance(place, int):
            link = Path(f"/proc/self/fd/{place}")
            place = link.readlink() if link.is_symlink() else ""
        return str(place).startswith(self._folder)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("forever", [False, True], ids=["once", "ever after"])
@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EROFS], ids=["EIO", "ENOSPC", "EROFS"])
def test_a_disk_that_fails_at_every_call_loses_no_count(folder: Path, code: int, forever: bool) -> None:
    with pytest.MonkeyPatch.context() as patch:
        disk = FailingDisk(patch, folder, -1, code, forever=forever)
        record(folder / "whole")
        calls = disk.count
    assert calls > 50
    for failing in range(1, calls + 1):
        with pytest.MonkeyPatch.context() as patch:
            FailingDisk(patch, folder, failing, code, forever=forever)
            pipeline, waited = record(folder / f"bag{failing}")
        try:
            check_that_nothing_is_missing(pipeline, waited)
        except (AssertionError, BagError) as error:
            raise AssertionError(f"call {failing} of {calls}, {pipeline.error!r}") from error
        shutil.rmtree(pipeline.folder)
