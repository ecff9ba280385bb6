# SPDX-License-Identifier: Apache-2.0
"""When all that was sent before a moment has been taken from a middleware that does not say what still waits in it."""

from __future__ import annotations

#: Looks in a row that must find nothing old: on a busy machine, what was sent may lie in its sender for a while.
_QUIET_POLLS = 5


class Drain:
    """Watches what is taken. An executor takes at least one waiting message of each topic between two looks.

    Args:
        moment: [ns] since the epoch; messages sent before it are waited for.
        limit: [ns] since the epoch; then it is over.
    """

    def __init__(self, moment: int, limit: int) -> None:
        self._moment = moment
        self._limit = limit
        self._quiet = 0

    def see(self, published: int) -> bool:
        """Take note of when a message was sent [ns] that was just taken; return whether that was before the moment."""
        before = published < self._moment
        if before:
            self._quiet = 0
        return before

    def look(self, now: int) -> bool:
        """Return whether nothing from before the moment is on its way any more; now in [ns]."""
        self._quiet += 1
        return self._quiet > _QUIET_POLLS or now > self._limit
