# SPDX-License-Identifier: Apache-2.0
"""What has not arrived at a recorder: messages that are lost, and messages that are still on their way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable

#: rmw's "this middleware has no sequence numbers".
UNSUPPORTED = 2**64 - 1
#: A message that comes later than this many others is lost.
_LATEST = 1000
#: A number further ahead than this is no loss but forged: a publisher of 200 Hz takes an hour and a half for so many.
_MAX_GAP = 1_000_000
#: Publishers of topics that are remembered, and gaps of each in which late numbers are looked for.
_MAX_PUBLISHERS, _MAX_GAPS = 2000, 20
#: Looks in a row that must find nothing old: on a busy machine, what was sent may lie in its sender for a while.
_QUIET_POLLS = 5


class LossCounter:
    """Counts lost messages of each topic.

    A middleware numbers messages per publisher. Where the message does not say which publisher it is from, gaps mean
    something on topics with one publisher only. A number that comes late, because its publisher has several threads,
    is not lost. Who sends under ever new names takes no more memory than `_MAX_PUBLISHERS`: those heard least go.
    """

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._publishers: dict[tuple[str, Hashable], _Publisher] = {}

    def add_sequence(self, topic: str, sequence: int | None, publisher: Hashable) -> None:
        """Take the sequence number of a message that arrived; None or `UNSUPPORTED` = it has none."""
        if sequence is None or sequence == UNSUPPORTED:
            return
        known = self._publishers.get((topic, publisher))
        if known is None:
            if len(self._publishers) >= _MAX_PUBLISHERS:
                self._forget_rare_publishers()
            self._publishers[topic, publisher] = _Publisher(sequence)
        elif lost := known.add_sequence(sequence):
            self.lost[topic] += lost

    def _forget_rare_publishers(self) -> None:
        by_heard = sorted(self._publishers.items(), key=lambda item: item[1].heard, reverse=True)
        self._publishers = dict(by_heard[: _MAX_PUBLISHERS // 2])


class _Publisher:
    """The numbers of one publisher of a topic."""

    __slots__ = ("_gaps", "_last", "heard")

    def __init__(self, first: int) -> None:
        self.heard = 1
        self._last = first
        self._gaps: list[range] = []

    def add_sequence(self, sequence: int) -> int:
        """Return by how many more are lost than before this number came: -1 where it had been taken for lost."""
        self.heard += 1
        ahead = sequence - self._last - 1
        if ahead == 0:
            self._last = sequence
            return 0
        if ahead < 0:
            return self._find_late(sequence)
        if ahead > _MAX_GAP:
            return 0
        oldest = sequence - _LATEST
        recent = [gap for gap in self._gaps if gap.stop > oldest][1 - _MAX_GAPS :]
        self._gaps = [*recent, range(max(self._last + 1, oldest), sequence)]
        self._last = sequence
        return ahead

    def _find_late(self, sequence: int) -> int:
        for place, gap in enumerate(self._gaps):
            if sequence in gap and sequence >= self._last - _LATEST:
                parts = range(gap.start, sequence), range(sequence + 1, gap.stop)
                self._gaps[place : place + 1] = [part for part in parts if part]
                return -1
        return 0


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
