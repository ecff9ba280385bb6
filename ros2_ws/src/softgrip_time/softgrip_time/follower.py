# SPDX-License-Identifier: Apache-2.0
"""What a node uses that must keep up with an emulated cell's time, but does not drive a device."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from softgrip_time.connection import Connection, TimeServerLostError
from softgrip_time.protocol import Join, Progress
from softgrip_time.units import to_ns, to_s

if TYPE_CHECKING:
    from pathlib import Path


class Follower:
    """Reports progress to the time server, whose time runs ahead of it by a bounded lag.

    Args:
        path: socket of the time server.
        name: of the node.
        follows: one of `softgrip_time.protocol.FOLLOWED`.
        lag_s: how far the time may run ahead [s].

    Raises:
        OSError: there is no server.
    """

    def __init__(self, path: Path, name: str, follows: str = "clock", lag_s: float = 0.05) -> None:
        self._connection = Connection(path, Join(name, follows, lag_s))
        self._epoch_ns = to_ns(self._connection.joined.epoch_s)
        self._reached_s = -1.0
        self._lock = threading.Lock()

    def report(self, epoch_ns: int) -> None:
        """Report that all is done up to a time since the epoch [ns]; no effect when the server has ended."""
        time_s = to_s(epoch_ns - self._epoch_ns)
        with self._lock, suppress(TimeServerLostError):
            if time_s > self._reached_s:
                self._reached_s = time_s
                self._connection.send(Progress(time_s))

    def close(self) -> None:
        """Leave."""
        self._connection.close()
