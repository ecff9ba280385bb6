# SPDX-License-Identifier: Apache-2.0
"""Runs what may not run within a callback of Zenoh.

Zenoh calls back about samples of a transient local topic with the subscriber's lock in hand (zenoh_ext 1.10,
AdvancedSubscriber). A callback that publishes to a subscriber of its own process, as a log line on /rosout, waits for
that lock, or holds one that whoever has it waits for: then no thread of the process reads from the network any more,
and where it hosts the router nobody hears anybody.
"""

from __future__ import annotations

import logging
import queue
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_LOG = logging.getLogger(__name__)
#: Calls that wait; what comes beyond them is forgotten.
_MAX_WAITING = 1000


class _Here(threading.local):
    """How many callbacks of Zenoh this thread is in: what it publishes may be taken in on the same thread."""

    inside = 0


_here = _Here()


class Callback:
    """Marks the time that a thread spends in a callback: ``with Callback():``."""

    def __enter__(self) -> None:
        _here.inside += 1

    def __exit__(self, *_: object) -> None:
        _here.inside -= 1


class Later:
    """Makes a call at once; when the caller is in a callback of Zenoh on a thread of its own, in the order of these."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(_MAX_WAITING)
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def run(self, call: Callable[[], None]) -> None:
        """Make a call, now or soon."""
        if not _here.inside:
            call()
            return
        try:
            self._waiting.put_nowait(call)
        except queue.Full:
            return
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._serve, name="later", daemon=True)
                self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                self._waiting.get()()
            except Exception:  # noqa: BLE001  one that fails holds up nobody
                _LOG.exception("could not do what had to wait")


#: Of this process.
LATER = Later()
