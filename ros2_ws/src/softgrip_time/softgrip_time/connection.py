# SPDX-License-Identifier: Apache-2.0
"""A participant's end of the connection to the time server."""

from __future__ import annotations

import select
import socket
from typing import TYPE_CHECKING

from softgrip_time.protocol import (
    MAX_PACKET,
    CancelRequest,
    Join,
    Packet,
    TimeGrant,
    TimeRequest,
    decode,
    encode,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

#: [s] for the server's first answer: it lives in a process that may be busy starting.
_JOIN_TIMEOUT_S = 60.0
#: [s] of the computer's time that bytes may take through the system, from the device that has sent them.
_ON_THE_WIRE_S = 1.0


class TimeServerLostError(ConnectionError):
    """The process that serves the time has ended."""


class Connection:
    """One participant.

    Args:
        path: socket of the time server.
        join: who this is.

    Raises:
        OSError: there is no server; says what to do.
    """

    def __init__(self, path: Path, join: Join) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_JOIN_TIMEOUT_S)
        self._number = 0
        try:
            self._socket.connect(str(path))
            self.send(join)
            self.joined = self._receive(0)
        except OSError as error:
            self._socket.close()
            raise OSError(
                f"lock-step {path}: expected the socket of an emulated cell, found: {error}; start emulated_cell "
                "first, or leave the parameter lockstep empty"
            ) from error
        self._socket.settimeout(None)

    def close(self) -> None:
        """Leave; the server notices."""
        self._socket.close()

    def send(self, packet: Packet) -> None:
        """Send a packet.

        Raises:
            TimeServerLostError: the server has ended.
        """
        try:
            self._socket.send(encode(packet))
        except OSError as error:
            raise TimeServerLostError(str(error)) from error

    def wait(
        self, files: Sequence[int], until_s: float, reads: str, written: Mapping[str, int]
    ) -> tuple[list[int], TimeGrant]:
        """Wait for a time or a readable file; return the files that can be read, and the server's time.

        Raises:
            TimeServerLostError: the server has ended.
        """
        while True:
            self._number += 1
            self.send(TimeRequest(self._number, until_s, reads, dict(written)))
            ready = select.select([self._socket.fileno(), *files], (), ())[0]
            if self._socket.fileno() not in ready:
                self.send(CancelRequest(self._number))
                return ready, self._receive(self._number)
            grant = self._receive(self._number)
            is_early = grant.now_s < until_s  # its device sends: the bytes follow
            ready = select.select(files, (), (), _ON_THE_WIRE_S if is_early else 0.0)[0] if files else []
            if ready or not is_early:
                return ready, grant

    def _receive(self, number: int) -> TimeGrant:
        """Return the answer to a request."""
        while True:
            try:
                data = self._socket.recv(MAX_PACKET)
            except OSError as error:
                raise TimeServerLostError(str(error)) from error
            if not data:
                raise TimeServerLostError("the time server has ended")
            packet = decode(data)
            if isinstance(packet, TimeGrant) and packet.number == number:
                return packet
