# SPDX-License-Identifier: Apache-2.0
"""How many messages never arrived: gaps in the sequence numbers that publishers give their messages."""

from __future__ import annotations

from collections import Counter
from typing import Any

#: rmw's "this middleware has no sequence numbers".
UNSUPPORTED = 2**64 - 1


#: A message that comes later than this many others is lost.
_LATEST = 1000


class LossCounter:
    """Counts lost messages of each topic.

    A middleware numbers messages per publisher. Where the message does not say which publisher it is from, gaps mean
    something on topics with one publisher only. A number that comes late, because its publisher has several threads,
    is not lost.
    """

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._last: dict[tuple[str, Any], int] = {}
        self._missing: dict[tuple[str, Any], set[int]] = {}

    def see(self, topic: str, sequence: int | None, publisher: Any) -> None:
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
