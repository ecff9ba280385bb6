# SPDX-License-Identifier: Apache-2.0
"""Between the callbacks of a node and a bag: a bounded queue and the thread that writes.

The disk may be slow or full; whoever delivers a message never waits for it. What does not fit is counted.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from softgrip_bag import writer
from softgrip_bag.writer import BagWriter

Result = TypeVar("Result")
_Message = tuple[str, int, int, bytes]
_Work = Callable[[BagWriter], None]


class Pipeline:
    """Writes a bag on a thread of its own.

    Args:
        bag: belongs to the pipeline from here on.
        capacity_bytes: messages may wait up to this size together.

    Attributes:
        dropped: topic -> messages that found the queue full or the disk failed.
        error: the write error that ended the recording, or None.
        peak_bytes: the most that ever waited.
    """

    def __init__(self, bag: BagWriter, capacity_bytes: int) -> None:
        self.folder = bag.folder
        self.dropped: Counter[str] = Counter()
        self.error: OSError | None = None
        self.peak_bytes = 0
        self.accepted = 0
        self._bag = bag
        self._capacity = capacity_bytes
        self._waiting_bytes = 0
        self._queue: deque[_Message | _Work] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._lost: Counter[str] = Counter()
        self._thread = threading.Thread(target=self._run, name="bag writer")
        self._thread.start()

    def put(self, topic: str, received: int, published: int, data: bytes) -> bool:
        """Queue a message; False when it had to be dropped."""
        with self._condition:
            if self.error is not None or self._waiting_bytes + len(data) > self._capacity:
                self.dropped[topic] += 1
                return False
            self._waiting_bytes += len(data)
            self.peak_bytes = max(self.peak_bytes, self._waiting_bytes)
            self.accepted += 1
            self._queue.append((topic, received, published, data))
        return True  # the thread looks by itself: a wake-up per message costs more than the message

    @property
    def waiting_bytes(self) -> int:
        """How much waits for the disk."""
        return self._waiting_bytes

    def call(self, work: Callable[[BagWriter], Result]) -> Future[Result]:
        """Run work on the bag after everything queued before it; its future fails when the recording has failed."""
        future: Future[Result] = Future()

        def run(bag: BagWriter) -> None:
            if self.error is not None:
                future.set_exception(self.error)
                return
            try:
                future.set_result(work(bag))
            except OSError as error:
                future.set_exception(error)
                raise

        with self._condition:
            self._queue.append(run)
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

    def _run(self) -> None:
        closing = False
        while not closing:
            with self._condition:
                if not self._closing and not self._queue:
                    self._condition.wait(writer.FLUSH_INTERVAL / 10)
                closing = self._closing
                batch, self._queue = self._queue, deque()
            self._write(batch)
        if self.error is None:
            try:
                missing = self.dropped + self._lost
                self._bag.add_fact("softgrip_dropped", {topic: str(count) for topic, count in missing.items()})
                self._bag.close()
            except OSError as error:
                self._fail(error)

    def _write(self, batch: deque[_Message | _Work]) -> None:
        written = 0
        for item in batch:
            try:
                if isinstance(item, tuple):
                    written += len(item[3])
                    if self.error is None:
                        self._bag.write(*item)
                    else:
                        self.dropped[item[0]] += 1
                else:
                    item(self._bag)
            except OSError as error:
                if isinstance(item, tuple):
                    self.dropped[item[0]] += 1
                self._fail(error)
        with self._condition:
            self._waiting_bytes -= written
        if self.error is None:
            try:
                self._bag.flush_if_due()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.error = error
        self._bag.abandon()
