# SPDX-License-Identifier: Apache-2.0
"""Drives the cell's time: as fast as asked for, never further than those who take part have kept up.

One thread serves all ports, advances the plant and speaks with the participants (`softgrip_time.protocol`). So a
driver's questions are answered in the same order, at the same times of the cell, on any computer, however busy. Without
participants the cell's time is the computer's. Lock-step simulators of flight stacks work so (PX4 guide, "Lockstep
Simulation").
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import select
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

from softgrip_emulator.participants import Participant, Participants
from softgrip_time.protocol import MAX_PACKET, CancelRequest, Join, TimeGrant, TimeRequest, decode, encode

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from softgrip_emulator.clock import SetClock
    from softgrip_emulator.wire.pty import DrivenPort

_log = logging.getLogger(__name__)

TICK_S: Final = 0.005
"""The cell's time goes on in steps of at most this."""
GIVE_UP_S: Final = 3.0
"""How long somebody may hold the time, by the computer's clock."""
_MAX_BEHIND_S: Final = 0.05
"""A participants' time that is further behind the computer's than this is not made up for."""
_POLL_S: Final = 0.1
"""Longest wait, by the computer's clock, before all is looked at again."""
_MAX_GAP_S: Final = 0.5
"""Between two looks, by the computer's clock; after a longer one nobody's silence counts."""
_JOIN_S: Final = 2.0


class TimeServer:
    """Serves a cell's time.

    Args:
        path: socket that participants connect to.
        clock: that it drives.
        ports: that it serves.
        advance: advances everything to a time of the cell [s]; called at each step, and again while the time stands.
        speed: cell seconds a second at most; 0 = as fast as all keep up, or the computer's time where there is nobody.
        expected: names without which 0 is the computer's time, too.
        is_busy: whether the cell itself must finish something before its time goes on to [s]; it calls `wake` then.
        give_up_s: see `Participants`.
    """

    def __init__(
        self,
        path: Path,
        clock: SetClock,
        ports: Callable[[], Collection[DrivenPort]],
        advance: Callable[[float], None],
        *,
        speed: float = 1.0,
        expected: Collection[str] = (),
        is_busy: Callable[[float], bool] = lambda _: False,
        give_up_s: float = GIVE_UP_S,
    ) -> None:
        self.clock = clock
        self.epoch_s = float(int(time.time()))  # whole: exact in nanoseconds
        self.participants = Participants(give_up_s)
        #: [s, the computer's] that each participant has held the time, by label
        self.held_s: dict[str, float] = {}
        self._path, self._ports, self._advance, self._is_busy = path, ports, advance, is_busy
        self._posted: deque[Callable[[], None]] = deque()
        self._speed, self._expected = speed, frozenset(expected)
        #: somebody lives, has lived or is expected to live by this time; it stays so, as participants come and go
        self.is_followed = bool(self._expected)
        self._anchor = (0.0, time.monotonic())
        self._looked_at = time.monotonic()
        self._connections: dict[int, tuple[socket.socket, Participant | None]] = {}
        self._readable: set[int] = set()  # files of ports that are to be served
        self._server: socket.socket | None = None
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._stop = threading.Event()
        self.thread = threading.Thread(target=self._run, name="cell-time", daemon=True)

    def open(self) -> None:
        """Make the socket.

        Raises:
            OSError: the folder cannot be written.
        """
        self._path.unlink(missing_ok=True)
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(self._path))
        self._server.listen()
        self._server.setblocking(False)

    def start(self) -> None:
        """Start the time."""
        self._anchor = (self.clock.now_s(), time.monotonic())
        self.thread.start()

    def close(self) -> None:
        """Stop the time. May be called more than once."""
        if self._stop.is_set():
            return
        self._stop.set()
        self.wake()
        if self.thread.is_alive():
            self.thread.join(_JOIN_S)
        for connection, _ in self._connections.values():
            connection.close()
        if self._server is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)
        os.close(self._wake_read)
        os.close(self._wake_write)

    def wake(self) -> None:
        """Wake the thread to look at everything now."""
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._wake_write, b"\0")

    def post(self, work: Callable[[], None]) -> None:
        """Run something in the thread, also while somebody holds the time."""
        self._posted.append(work)
        self.wake()

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._step()
            except Exception:  # noqa: BLE001  without its time the whole cell would stand
                _log.exception("the cell's time failed in a step; it goes on")
                self._stop.wait(_POLL_S)

    def _step(self) -> None:
        while self._posted:
            self._posted.popleft()()
        self._serve_ports()
        now_s, computer_s = self.clock.now_s(), time.monotonic()
        if computer_s - self._looked_at > _MAX_GAP_S:  # this thread was away itself: it blames nobody
            self._wait(0.0)
            self.participants.restart_timeouts()
        self._looked_at = computer_s
        if self.participants.update_rest(now_s):
            self._advance(now_s)  # who is further behind than work allows learns the time at once
        received = {port.terminal: port.received for port in self._ports()}
        holder = self.participants.find_holder(now_s, received, computer_s)
        if holder is not None:
            self._hold(holder, computer_s)
            return
        target_s = self._target_s(now_s)
        if self._is_busy(target_s):
            self._wait(_POLL_S)
            return
        early_s = self._due_at(target_s, computer_s) - computer_s
        if early_s > 0.0:
            self._wait(min(early_s, _POLL_S))
            return
        if not self._wait(0.0):  # a packet or byte that has come meanwhile may hold the time
            self._go_to(target_s)

    def _hold(self, holder: Participant, since_s: float) -> None:
        """Wait for who holds the time; one that has joined late learns the time all the same."""
        if not self._wait(_POLL_S):
            self._advance(self.clock.now_s())
        label = holder.label
        self.held_s[label] = self.held_s.get(label, 0.0) + time.monotonic() - since_s

    def _serve_ports(self) -> None:
        readable, self._readable = self._readable, set()
        for port in self._ports():
            if port.is_service_due(readable):
                port.serve(self._release_readers)

    def _release_readers(self, terminal: str) -> None:
        """Grant the requests of those who wait for bytes of a device that is about to send some."""
        for one in self.participants.readers(terminal):
            self._release(one)

    def _target_s(self, now_s: float) -> float:
        """Return the next time at which something is to happen [s]."""
        tick_s = TICK_S * (math.floor(now_s / TICK_S + 1e-6) + 1)
        due = [_unscaled(due_s, port.clock.scale) for port in self._ports() if (due_s := port.next_due_s()) is not None]
        return max(now_s, min([tick_s, self.participants.limit_s(), *due]))

    def _due_at(self, target_s: float, computer_s: float) -> float:
        """Return when a time of the cell may come, by the computer's clock, which is at ``computer_s`` [s]."""
        names = self.participants.names()
        speed = self._speed if names and self._expected <= names else (self._speed or 1.0)
        if speed == 0.0:
            self._anchor = (target_s, computer_s)
            return computer_s
        anchor_s, anchored_at = self._anchor
        due_at = anchored_at + (target_s - anchor_s) / speed
        is_late = computer_s - due_at > _MAX_BEHIND_S and self.participants.all
        if is_late or due_at - computer_s > 1.0:  # somebody has held it, or the speed was another
            self._anchor = (target_s, computer_s)
            return computer_s
        return due_at

    def _go_to(self, target_s: float) -> None:
        self.clock.set(target_s)
        self._advance(target_s)
        self._serve_ports()
        for one in self.participants.due(target_s):
            self._release(one)

    # -- participants ----------------------------------------------------------------------------------------------

    def _wait(self, timeout_s: float) -> bool:
        """Wait for a packet, or for bytes on a port; return whether there were any."""
        assert self._server is not None
        watched = [self._wake_read, self._server.fileno(), *self._connections]
        masters = [file for port in self._ports() for file in port.files()]
        ready = select.select([*watched, *masters], [], [], timeout_s)[0]
        for file in ready:
            if file == self._wake_read:
                with contextlib.suppress(BlockingIOError):
                    os.read(self._wake_read, MAX_PACKET)
            elif file == self._server.fileno():
                self._accept()
            elif file in self._connections:
                self._receive(file)
        self._readable.update(set(masters).intersection(ready))
        return bool(ready)

    def _accept(self) -> None:
        assert self._server is not None
        try:
            connection, _ = self._server.accept()
        except OSError:
            return
        connection.setblocking(False)
        self._connections[connection.fileno()] = connection, None

    def _receive(self, file: int) -> None:
        connection, participant = self._connections[file]
        try:
            while data := connection.recv(MAX_PACKET):
                participant = self._handle(connection, participant, data)
        except BlockingIOError:
            self._connections[file] = connection, participant
            return
        except OSError:
            pass
        except ValueError as error:
            _log.warning("%s", error)
        self._drop(file, participant)

    def _handle(self, connection: socket.socket, participant: Participant | None, data: bytes) -> Participant:
        packet = decode(data)
        if participant is None:
            if not isinstance(packet, Join):
                raise ValueError(f"lock-step: expected a join first, found {packet}")
            participant = Participant(packet, progress_s=self.clock.now_s())
            self.participants.all.append(participant)
            self.is_followed = True
            self._connections[connection.fileno()] = connection, participant
            self._grant(connection, 0)
            return participant
        is_answered, before = participant.is_granted, participant.request
        participant.update(packet)
        self.participants.observe_work(before, packet, self.clock.now_s())
        if isinstance(packet, CancelRequest):
            if not is_answered:
                self._grant(connection, packet.number)
        elif isinstance(packet, TimeRequest) and packet.until_s <= self.clock.now_s():
            self._release(participant)
        return participant

    def _drop(self, file: int, participant: Participant | None) -> None:
        connection, _ = self._connections.pop(file)
        connection.close()
        if participant in self.participants.all:
            self.participants.all.remove(participant)

    def _release(self, participant: Participant) -> None:
        """Grant the request of a stepper."""
        assert participant.request is not None
        participant.is_granted = True
        for connection, one in self._connections.values():
            if one is participant:
                self._grant(connection, participant.request.number)

    def _grant(self, connection: socket.socket, number: int) -> None:
        with contextlib.suppress(OSError):  # it has gone: the next look finds out
            connection.send(encode(TimeGrant(number, self.clock.now_s(), self.epoch_s)))


def _unscaled(due_s: float, scale: float) -> float:
    """Return the first time whose scaled one is not before ``due_s``: a rounded one would be due for ever."""
    time_s = due_s / scale
    while time_s * scale < due_s:
        time_s = math.nextafter(time_s, math.inf)
    return time_s
