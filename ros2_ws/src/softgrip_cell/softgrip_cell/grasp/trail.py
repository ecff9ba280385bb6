# SPDX-License-Identifier: Apache-2.0
"""Where the fingers were in the last moments."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence


class Trail:
    """Pulled lengths of all fingers over a time span [s]."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = round(span_s * 1e9)
        self._rows: deque[tuple[int, tuple[float, ...]]] = deque()

    def add(self, now_ns: int, pulled_m: Sequence[float]) -> None:
        """Take the pulled lengths of a sample."""
        self._rows.append((now_ns, tuple(pulled_m)))
        while len(self._rows) > 1 and self._rows[1][0] <= now_ns - self._span_ns:
            self._rows.popleft()

    def advances_m(self, now_ns: int, within_s: float) -> tuple[float, ...]:
        """How far every finger has moved lately [m]; infinite before they were watched for so long."""
        then_ns = now_ns - round(within_s * 1e9)
        last = self._rows[-1][1]
        before = next((row for at_ns, row in reversed(self._rows) if at_ns <= then_ns), None)
        if before is None:
            return (math.inf,) * len(last)
        return tuple(abs(now - then) for now, then in zip(last, before, strict=True))

    def advance_m(self, now_ns: int, within_s: float) -> float:
        """How far the finger that went farthest has moved lately [m]."""
        return max(self.advances_m(now_ns, within_s))
