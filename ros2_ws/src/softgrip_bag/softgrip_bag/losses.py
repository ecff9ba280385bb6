# SPDX-License-Identifier: Apache-2.0
"""How many messages never arrived: gaps in the sequence numbers that publishers give their messages."""

from __future__ import annotations

from collections import Counter
from typing import Any

#: rmw's "this middleware has no sequence numbers".
UNSUPPORTED = 2**64 - 1


class LossCounter:
    """Counts lost messages of each topic.

    A middleware numbers messages per publisher. Where the message does not say which publisher it is from, gaps mean
    something on topics with one publisher only.
    """

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._last: dict[tuple[str, Any], int] = {}

    def see(self, topic: str, sequence: int | None, publisher: Any) -> None:
        """Take the sequence number of a message that arrived; None or `UNSUPPORTED` = it has none."""
        if sequence is None or sequence == UNSUPPORTED:
            return
        key = (topic, publisher)
        last = self._last.get(key)
        if last is None or sequence > last:
            self._last[key] = sequence
        if last is not None and sequence > last + 1:
            self.lost[topic] += sequence - last - 1
