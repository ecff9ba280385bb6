# SPDX-License-Identifier: Apache-2.0
"""The clock of code that steps with an emulated cell: its time stands unless that code waits."""

from __future__ import annotations

import os
import select
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from softgrip_time.connection import Connection, TimeServerLostError
from softgrip_time.protocol import Join, TimeGrant
from softgrip_time.units import to_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


class SimulatedClock:
    """A `Clock` of the emulated cell.

    A thread within `stepping` is one participant; a wait of any other thread is a participant of its own for as long as
    it lasts. When the server ends, time goes on at the computer's pace: watchdogs of silence fire all the same.

    Args:
        path: socket of the time server.
        name: of the node.

    Raises:
        OSError: there is no server.
    """

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        self._own = threading.local()
        self._last_s, self._epoch_s = 0.0, 0.0
        self._lost_at: float | None = None
        #: path and bytes written, of each attached terminal
        self._terminals: dict[int, str] = {}
        self._written: dict[str, int] = {}
        connection = Connection(path, Join(name))
        self._update(connection.joined)
        connection.close()

    def now_s(self) -> float:
        """Return the time [s] of the last grant to any thread: exact for one that steps."""
        lost_at = self._lost_at
        return self._last_s + (0.0 if lost_at is None else time.monotonic() - lost_at)

    def epoch_ns(self, at_s: float) -> int:
        """See `Clock`."""
        return to_ns(self._epoch_s) + to_ns(at_s)

    def wait(self, until_s: float) -> None:
        """See `Clock`."""
        self.wait_readable((), until_s)

    def wait_readable(self, files: Sequence[int], until_s: float) -> list[int]:
        """See `Clock`."""
        ready = select.select(files, (), (), 0.0)[0] if files else []
        if ready:
            return ready
        if self._lost_at is None:
            with suppress(TimeServerLostError), self._participant() as connection:
                reads = next((self._terminals[file] for file in files if file in self._terminals), "")
                ready, grant = connection.wait(files, until_s, reads, self._written)
                self._update(grant)
                return ready
            self._lost_at = time.monotonic()
        return select.select(files, (), (), max(0.0, until_s - self.now_s()))[0]

    def attach(self, device: int) -> None:
        """See `Clock`."""
        with suppress(OSError):  # a pipe or a socket has no time server behind it
            self._terminals[device] = os.ttyname(device)
            self._written[self._terminals[device]] = 0

    def detach(self, device: int) -> None:
        """See `Clock`."""
        terminal = self._terminals.pop(device, "")
        self._written.pop(terminal, None)

    def count_written(self, device: int, size: int) -> None:
        """See `Clock`."""
        terminal = self._terminals.get(device)
        if terminal is not None:
            self._written[terminal] += size

    @contextmanager
    def stepping(self) -> Iterator[None]:
        """See `Clock`."""
        self._join()
        try:
            yield
        finally:
            self._leave()

    @contextmanager
    def detached(self) -> Iterator[None]:
        """See `Clock`."""
        is_stepping = self._connection is not None
        self._leave()
        try:
            yield
        finally:
            if is_stepping:
                self._join()

    @property
    def _connection(self) -> Connection | None:
        connection: Connection | None = getattr(self._own, "connection", None)
        return connection

    def _join(self) -> None:
        self._own.connection = self._connect()

    def _leave(self) -> None:
        connection, self._own.connection = self._connection, None
        if connection is not None:
            connection.close()

    def _connect(self) -> Connection | None:
        """Return a new connection; None when the server has ended, from when on the time is the computer's."""
        if self._lost_at is not None:
            return None
        try:
            connection = Connection(self._path, Join(self._name))
        except OSError:
            self._lost_at = time.monotonic()
            return None
        self._update(connection.joined)
        return connection

    @contextmanager
    def _participant(self) -> Iterator[Connection]:
        """Give this thread's connection, or one for the moment."""
        own = self._connection
        if own is not None:
            yield own
            return
        connection = self._connect()
        if connection is None:
            raise TimeServerLostError("the time server has ended")
        try:
            yield connection
        finally:
            connection.close()

    def _update(self, grant: TimeGrant) -> None:
        self._last_s, self._epoch_s = max(self._last_s, grant.now_s), grant.epoch_s
