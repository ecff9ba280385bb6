# SPDX-License-Identifier: Apache-2.0
"""What has not arrived at a recorder: messages that are lost, and messages that are still on their way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable

#: rmw's "this middleware has no sequence numbers".
UNSUPPORTED = 2**64 - 1
#: A message that comes later than this many others is lost.
_LATEST = 1000
#: Looks in a row that must find nothing old: on a busy machine, what was sent may lie in its sender for a while.
_QUIET_POLLS = 5


class LossCounter:
    """Counts lost messages of each topic.

    A middleware numbers messages per publisher. Where the message does not say which publisher it is from, gaps mean
    something on topics with one publisher only. A number that comes late, because its publisher has several threads,
    is not lost.
    """

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._last: dict[tuple[str, Hashable], int] = {}
        self._missing: dict[tuple[str, Hashable], set[int]] = {}

    def add_sequence(self, topic: str, sequence: int | None, publisher: Hashable) -> None:
        """Take the sequence number of a message that arrived; None or `UNSUPPORTED` = it has none."""
        if sequence is None or sequence == UNSUPPORTED:
            return
        key = (topic, publisher)
        last = self._last.get(key)
        if last is None or sequence == last + 1:
            self._last[key] = sequence
        elif sequence > last:
            self._last[key] = sequence
            self.lost[topic] += sequence - last - 1
            missing = self._missing.setdefault(key, set())
            missing.update(range(max(last + 1, sequence - _LATEST), sequence))
            missing.difference_update([number for number in missing if number < sequence - _LATEST])
        elif sequence in self._missing.get(key, ()):
            self._missing[key].remove(sequence)
            self.lost[topic] -= 1


class Drain:
    """Finds out when all that was sent before a moment has been taken from a middleware that does not say so.

    An executor takes at least one waiting message of each topic between two looks.

    Args:
        moment: [ns] since the epoch; messages sent before it are waited for.
        limit: [ns] since the epoch; then it is over.
    """

    def __init__(self, moment: int, limit: int) -> None:
        self._moment = moment
        self._limit = limit
        self._quiet = 0

    def admit_message(self, published: int) -> bool:
        """Record when a message was sent [ns] that was just taken; return whether that was before the moment."""
        before = published < self._moment
        if before:
            self._quiet = 0
        return before

    def check_quiet(self, now: int) -> bool:
        """Return whether nothing from before the moment is on its way any more; now in [ns]."""
        self._quiet += 1
        return self._quiet > _QUIET_POLLS or now > self._limit
