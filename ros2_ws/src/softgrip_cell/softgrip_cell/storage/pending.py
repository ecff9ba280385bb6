# SPDX-License-Identifier: Apache-2.0
"""Writes that the database did not take: kept in their order and tried again, so that nothing that happened is lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from softgrip_cell.errors import StorageError

Write = Callable[[], None]


class PendingWrites:
    """Does writes, or keeps them until they can be done."""

    def __init__(self) -> None:
        self._pending: deque[Write] = deque()
        self._fault = ""

    @property
    def fault(self) -> str:
        """Why the database could not be written, empty while it can."""
        return self._fault

    def do(self, write: Write) -> None:
        """Do a write now, or once those before it could be done."""
        self._pending.append(write)
        if len(self._pending) == 1:
            self.retry()

    def refuse(self, error: StorageError, probe: Write) -> None:
        """Record a write that was given up; the fault lasts until ``probe`` can be done."""
        self._fault = str(error)
        if not self._pending:
            self._pending.append(probe)

    def retry(self) -> None:
        """Try what is kept, in its order; stop at the first that fails."""
        try:
            while self._pending:
                self._pending[0]()
                self._pending.popleft()
        except StorageError as error:
            self._fault = str(error)
        else:
            self._fault = ""
