# SPDX-License-Identifier: Apache-2.0
"""Between the callbacks of a node and a bag: a bounded queue and the thread that writes.

The disk may be slow or full; whoever delivers a message never waits for it. What does not fit is counted, and whatever
ends the thread is seen. At the end each message that was offered is in the bag, was deleted with its file because only
so many are kept, or is counted as dropped.
"""

from __future__ import annotations

import os
import threading
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Generic, TypeVar

from softgrip_bag import salvage, writer
from softgrip_bag.errors import BagError, DiskError, RecordRefusedError
from softgrip_bag.mcap_file import CHUNK_BYTES
from softgrip_bag.writer import BagWriter

Result = TypeVar("Result")
_Message = tuple[str, int, int, bytes]


class _Work(Generic[Result]):
    """Something to do with the bag, and whoever waits for it."""

    def __init__(self, call: Callable[[BagWriter], Result], future: Future[Result]) -> None:
        self._call = call
        self._future = future

    def run(self, bag: BagWriter) -> None:
        try:
            result = self._call(bag)
        except RecordRefusedError as error:
            self.refuse(error)
        except BaseException as error:
            self.refuse(error)
            raise
        else:
            self._future.set_result(result)

    def refuse(self, error: BaseException) -> None:
        self._future.set_exception(error)


class Pipeline:
    """Writes a bag on a thread of its own.

    Args:
        bag: belongs to the pipeline from here on.
        capacity_bytes: messages may wait up to this size together.
        reserve_bytes: the recording is finished when the disk has less room than this.

    Attributes:
        error: what ended the recording before `close`, or None.
        peak_bytes: the most that ever waited.
    """

    def __init__(self, bag: BagWriter, capacity_bytes: int, reserve_bytes: int = 0) -> None:
        self.folder = bag.folder
        self.error: BaseException | None = None
        self.peak_bytes = 0
        self._bag = bag
        self._capacity = capacity_bytes
        self._reserve = reserve_bytes
        self._unchecked_bytes = CHUNK_BYTES  # written since the room on the disk was looked at
        self._offered: Counter[str] = Counter()
        self._accepted: Counter[str] = Counter()  # less those that the bag refused
        self._stored: Counter[str] | None = None  # known when the thread has ended
        self._waiting_bytes = 0
        self._queue: deque[_Message | _Work[Any]] = deque()
        self._batch: deque[_Message | _Work[Any]] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._lost: Counter[str] = Counter()
        # daemon: where nobody gets to close this, the process still ends, and the next recorder repairs the bag
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def put(self, topic: str, received: int, published: int, data: bytes) -> bool:
        """Queue a message; False when it had to be dropped."""
        with self._condition:
            self._offered[topic] += 1
            if self._has_ended or self._waiting_bytes + len(data) > self._capacity:
                return False
            self._waiting_bytes += len(data)
            self.peak_bytes = max(self.peak_bytes, self._waiting_bytes)
            self._accepted[topic] += 1
            self._queue.append((topic, received, published, data))
        return True  # the thread looks by itself: a wake-up per message costs more than the message

    @property
    def waiting_bytes(self) -> int:
        """How much waits for the disk."""
        return self._waiting_bytes

    @property
    def accepted(self) -> int:
        """Messages that are in the bag, will be, or were deleted with its oldest files."""
        with self._condition:
            return (self._accepted if self._stored is None else self._stored).total()

    @property
    def dropped(self) -> Counter[str]:
        """Topic -> messages offered that found the queue full or the disk failed, or that the bag refused."""
        with self._condition:
            return self._offered - (self._accepted if self._stored is None else self._stored)

    @property
    def removed(self) -> Counter[str]:
        """Topic -> messages deleted with the oldest files, because only so many are kept."""
        return self._bag.removed

    @property
    def clamped_stamps(self) -> int:
        """Messages whose times could not be written as they were."""
        return self._bag.clamped_stamps

    def call(self, work: Callable[[BagWriter], Result]) -> Future[Result]:
        """Run work on the bag after everything queued before it; its future fails when the recording has failed."""
        future: Future[Result] = Future()
        with self._condition:
            if self._has_ended:
                future.set_exception(self.error or BagError(f"{self.folder}: the recording has ended"))
            else:
                self._queue.append(_Work(work, future))
                self._condition.notify()
        return future

    def close(self, lost: Counter[str] | None = None) -> Path:
        """Write what waits, finish the bag; returns its folder. `error` says when that failed.

        Args:
            lost: topic -> messages that never arrived; noted in the bag with those dropped here.
        """
        with self._condition:
            self._lost = lost or Counter()
            self._closing = True
            self._condition.notify()
        self._thread.join()
        return self.folder

    @property
    def _has_ended(self) -> bool:
        """Whether nothing is taken any more: the recording has failed or is being finished, or its thread is gone."""
        return self.error is not None or self._closing or not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._serve()
            self._finish()
        except BaseException as error:  # noqa: BLE001  whatever ends this thread has to be seen outside
            self._fail(error)

    def _serve(self) -> None:
        closing = False
        while not closing:
            with self._condition:
                if not self._closing and not self._queue:
                    self._condition.wait(writer.FLUSH_INTERVAL / 10)
                closing = self._closing
                self._batch, self._queue = self._queue, deque()
            written = 0
            while self._batch:
                written += self._write(self._batch.popleft())
                if self._is_disk_low():
                    self._end_early()
                    return
            with self._condition:
                self._waiting_bytes -= written
            self._bag.flush_if_due()

    def _write(self, item: _Message | _Work[Any]) -> int:
        if isinstance(item, _Work):
            item.run(self._bag)
            return 0
        try:
            self._bag.write(*item)
        except RecordRefusedError:
            with self._condition:
                self._accepted[item[0]] -= 1
        self._unchecked_bytes += len(item[3])
        return len(item[3])

    def _is_disk_low(self) -> bool:
        if self._reserve == 0 or self._unchecked_bytes < CHUNK_BYTES:
            return False
        self._unchecked_bytes = 0
        return free_bytes(self.folder) < self._reserve

    def _end_early(self) -> None:
        """Take nothing more; what waits is dropped, what was written is finished while there is room for that."""
        with self._condition:
            self.error = DiskError(
                f"expected at least {self._reserve / 1e6:.0f} MB of room on the disk (reserve_mb), found "
                f"{free_bytes(self.folder) / 1e6:.0f} MB; the bag is whole up to here"
            )
            for item in (*self._batch, *self._queue):
                if isinstance(item, _Work):
                    item.refuse(self.error)
                else:
                    self._accepted[item[0]] -= 1
            self._batch, self._queue = deque(), deque()

    def _finish(self) -> None:
        missing = self.dropped + self._lost
        self._bag.add_fact("softgrip_dropped", {topic: str(count) for topic, count in missing.items()})
        self._bag.close()
        stored = self._bag.stored + self._bag.removed
        if stored != +self._accepted:
            raise BagError(
                f"expected {self._accepted.total()} messages in the bag, found {stored.total()} in its files"
            )
        with self._condition:
            self._stored = stored

    def _fail(self, error: BaseException) -> None:
        with self._condition:
            self.error = error
        try:
            self._bag.abandon()
            stored = self._bag.stored + self._bag.removed
        except Exception as second:  # noqa: BLE001  it goes with the first error; what is there is counted by reading
            error.add_note(f"and, while the files were closed: {second!r}")
            stored = salvage.readable_counts(*sorted(self.folder.glob("*.mcap")))
        with self._condition:
            self._stored = stored
            waiting = [*self._batch, *self._queue]
            self._batch, self._queue = deque(), deque()
            self._waiting_bytes = 0
        for item in waiting:
            if isinstance(item, _Work):
                item.refuse(error)


def free_bytes(folder: Path) -> int:
    """Return how much room a folder's disk has for this process [byte].

    Raises:
        OSError: no such folder, or the disk is gone.
    """
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize
