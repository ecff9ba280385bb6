# SPDX-License-Identifier: Apache-2.0
"""Where the fingers were in the last moments, and how hard they pressed."""

from __future__ import annotations

import math
from collections import deque

from softgrip_cell.grasp.reading import Reading


class Trail:
    """Pulled lengths, tensions and excess tensions of all fingers over a time span [s]."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = round(span_s * 1e9)
        self._rows: deque[tuple[int, tuple[Reading, ...]]] = deque()

    def add(self, now_ns: int, readings: tuple[Reading, ...]) -> None:
        """Take the readings of a sample."""
        self._rows.append((now_ns, readings))
        while len(self._rows) > 1 and self._rows[1][0] <= now_ns - self._span_ns:
            self._rows.popleft()

    def advances_m(self, now_ns: int, within_s: float) -> tuple[float, ...]:
        """How far every finger has moved lately [m]; infinite before they were watched for so long."""
        then_ns = now_ns - round(within_s * 1e9)
        last = self._rows[-1][1]
        before = next((readings for at_ns, readings in reversed(self._rows) if at_ns <= then_ns), None)
        if before is None:
            return (math.inf,) * len(last)
        return tuple(abs(now.pulled_m - then.pulled_m) for now, then in zip(last, before, strict=True))

    def advance_m(self, now_ns: int, within_s: float) -> float:
        """How far the finger that went farthest has moved lately [m]."""
        return max(self.advances_m(now_ns, within_s))

    def hardest(self, now_ns: int, within_s: float) -> tuple[Reading, ...]:
        """Every finger's reading with the highest tension of late."""
        then_ns = now_ns - round(within_s * 1e9)
        late = [readings for at_ns, readings in self._rows if at_ns >= then_ns]
        return tuple(max(column, key=lambda reading: reading.tension_n) for column in zip(*late, strict=True))
