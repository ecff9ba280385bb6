# SPDX-License-Identifier: Apache-2.0
"""The last seconds of all topics, in memory, and when to keep them: when something fails that had not failed before."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from softgrip_bag.errors import BagError
from softgrip_bag.reader import RawMessage
from softgrip_time.units import to_ns


def snapshot_seconds(seconds: float) -> float:
    """Return the length of a snapshot that somebody asked for [s], 0 for all that is kept.

    Raises:
        BagError: not a number, or negative.
    """
    if not 0.0 <= seconds < float("inf"):
        raise BagError(f"expected 0 (all that is kept) or a number of seconds, found {seconds}")
    return seconds


#: [byte] that a waiting message takes beside its data: the object, its two times, and what `bytes` has itself
MESSAGE_BYTES = 200


class Ring:
    """Keeps what was received in the last seconds, and the last message of each latched topic for ever.

    Args:
        seconds: [s] how long; 0 = only latched topics.
        capacity_bytes: [byte] of memory; the oldest goes when there is more.
    """

    def __init__(self, seconds: float, capacity_bytes: int) -> None:
        self._length = to_ns(seconds)
        self._capacity = capacity_bytes
        self._messages: deque[RawMessage] = deque()
        self._latched: dict[str, RawMessage] = {}
        self._before: dict[str, RawMessage] = {}  # the last of each latched topic that is older than what is kept
        self._bytes = 0

    def add(self, message: RawMessage, *, latched: bool) -> None:
        """Keep a message."""
        if latched:
            self._latched[message.topic] = message
        if self._length == 0:
            return
        self._messages.append(message)
        self._bytes += len(message.data) + MESSAGE_BYTES
        while self._bytes > self._capacity or self._messages[0].received < message.received - self._length:
            oldest = self._messages.popleft()
            self._bytes -= len(oldest.data) + MESSAGE_BYTES
            if oldest.topic in self._latched:
                self._before[oldest.topic] = oldest

    def latched(self) -> list[RawMessage]:
        """Return the last message of each latched topic, oldest first."""
        return sorted(self._latched.values(), key=lambda message: message.received)

    def last(self, seconds: float = 0.0) -> list[RawMessage]:
        """Return the messages of the last seconds (0 = all kept), after the latched ones that held when they began."""
        if not self._messages:
            return self.latched()
        since = self._messages[-1].received - to_ns(seconds) if seconds else 0
        held = dict(self._before)
        held |= {m.topic: m for m in self._messages if m.received < since and m.topic in self._latched}
        recent = [message for message in self._messages if message.received >= since]
        return sorted(held.values(), key=lambda message: message.received) + recent


class FaultWatch:
    """Remembers what is wrong, so that each fault counts once.

    Args:
        after: [s] how long after a fault the picture is complete.
        pause: [s] at least between two pictures: what fails in a row is one event.
    """

    def __init__(self, after: float, pause: float) -> None:
        self._after = after
        self._pause = pause
        self._wrong: set[str] = set()
        self._due: float | None = None
        self._last = float("-inf")
        self._why = ""

    def observe_faults(self, state: Mapping[str, str], now: float) -> None:
        """Take what is known of some components.

        Args:
            state: component -> what is wrong with it, empty when nothing.
            now: [s] monotonic.
        """
        new = [f"{name}: {text}" for name, text in state.items() if text and name not in self._wrong]
        self._wrong -= {name for name, text in state.items() if not text}
        self._wrong |= {name for name, text in state.items() if text}
        if new and self._due is None and now - self._last >= self._pause:
            self._due, self._why = now + self._after, new[0]

    def due(self, now: float) -> str:
        """Return the fault whose picture is complete, once; empty when there is none."""
        if self._due is None or now < self._due:
            return ""
        self._due, self._last = None, now
        return self._why
