# SPDX-License-Identifier: Apache-2.0
"""A clock that a test sets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class ManualClock:
    """Gives the time ``s`` [s] that it was set to."""

    s: float = 0.0

    def __call__(self) -> float:
        """Return the time [s]."""
        return self.s
