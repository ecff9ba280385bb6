# SPDX-License-Identifier: Apache-2.0
"""When to keep the last seconds by itself: something has failed that had not failed before."""

from __future__ import annotations

from collections.abc import Mapping


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

    def see(self, state: Mapping[str, str], now: float) -> None:
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
