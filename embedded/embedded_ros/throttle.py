# SPDX-License-Identifier: Apache-2.0
"""Lets one line through where a thousand would say the same."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD_S = 5.0
_MAX_KEYS = 256


class Throttle:
    """Admit one line a period and key.

    Args:
        period_s: [s] between lines of one key.
        clock: monotonic [s].
    """

    def __init__(self, period_s: float = PERIOD_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._period = period_s
        self._clock = clock
        self._lock = threading.Lock()
        self._keys: OrderedDict[object, tuple[float, int]] = OrderedDict()  # when admitted, held back since

    def admit(self, key: object) -> int | None:
        """Return how many lines of a key were held back since the last one; None: hold this one back, too."""
        now = self._clock()
        with self._lock:
            admitted, held = self._keys.get(key, (None, 0))
            if admitted is not None and now - admitted < self._period:
                self._keys[key] = admitted, held + 1
                return None
            self._keys[key] = now, 0
            self._keys.move_to_end(key)
            while len(self._keys) > _MAX_KEYS:
                self._keys.popitem(last=False)
            return held
