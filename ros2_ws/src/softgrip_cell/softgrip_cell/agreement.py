# SPDX-License-Identifier: Apache-2.0
"""One message alone decides nothing that lasts: it may be another node's, or wrong."""

from __future__ import annotations


class Agreement:
    """Counts observations in a row that say the same.

    Args:
        needed: so many in a row are believed.
    """

    def __init__(self, needed: int) -> None:
        self._needed = needed
        self._run = 0

    def observe(self, agrees: bool) -> bool:
        """Take one observation; return whether enough in a row, this one included, have agreed."""
        self._run = self._run + 1 if agrees else 0
        return self._run >= self._needed

    def forget(self) -> None:
        """Begin again."""
        self._run = 0
