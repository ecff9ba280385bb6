# SPDX-License-Identifier: Apache-2.0
"""A serial port on a raw pseudo-terminal: paced by baud rate, can be unplugged and plugged in again.

`DrivenPort` is served by whoever drives the time of its cell, `PtyPort` by a thread of its own. The host opens a stable
path (a symbolic link), as it would open a udev name; behind it stands one `WireDevice`.
Facts about Linux pseudo-terminals used here: the master can read the baud rate the host has set; the master sees
POLLHUP while no host has the port open; closing the master gives the host EIO, as pulling the USB plug does.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import select
import threading
import tty
from collections import deque
from typing import TYPE_CHECKING, Final, Self

from softgrip_emulator.clock import RealTimeClock
from softgrip_emulator.wire.device import BITS_PER_BYTE, Chunk, WireDevice

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence
    from pathlib import Path

    from softgrip_emulator.clock import CellClock

_log = logging.getLogger(__name__)

_READ_BYTES: Final = 4096
_ABSENT_HOST_POLL_S: Final = 0.01
"""How often to look whether a host has opened the port (no event tells)."""
_QUIET_DEVICE_POLL_S: Final = 0.1
"""How often to ask a device that has nothing to say whether it still has not."""
_BURST_S: Final = 0.002
"""Longer packets are handed over in pieces of this duration, as a USB adapter does."""
_JOIN_S: Final = 2.0

_TCGETS2: Final = 0x802C542A
"""Linux ioctl that reads custom speeds too (asm-generic/ioctls.h); termios.tcgetattr knows the standard ones only."""


class DrivenPort:
    """One emulated serial port: link path outside, device inside; somebody calls `serve` again and again.

    `unplug` and `plug` are what a hand does to the cable. All other methods belong to the thread that serves.

    Args:
        link: path the host opens; its folder is made when missing, an old link is replaced.
        device: what answers.
        clock: cell time for the device and for pacing.
        paced: False hands bytes over at once (tests of behaviour, not of timing).
        wake: called when there is something to serve that no file tells of.
    """

    def __init__(
        self,
        link: Path,
        device: WireDevice,
        clock: CellClock,
        *,
        paced: bool = True,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        self.link = link
        self.clock = clock
        #: path of the terminal that the link leads to; "" while there is none
        self.terminal = ""
        #: bytes received from the host since it opened the port
        self.received = 0
        self._device = device
        self._line = Line(paced)
        self._wake = wake
        self._master: int | None = None
        self._poller = select.poll()
        self._attached = False
        self._requested = True
        self._settled = threading.Event()
        self._server: threading.Thread | None = None

    # -- what a hand does ------------------------------------------------------------------------------------------

    def plug(self) -> None:
        """Make the port appear (again) under its link; no effect when it is there."""
        self._settle(requested=True)

    def unplug(self) -> None:
        """Make the port vanish; a host that has it open gets EIO. No effect when it is gone."""
        self._settle(requested=False)

    @property
    def plugged(self) -> bool:
        """True while the port exists."""
        return self._master is not None

    @property
    def attached(self) -> bool:
        """True while a host has the port open."""
        return self._attached

    # -- for who serves --------------------------------------------------------------------------------------------

    def open(self, server: threading.Thread) -> None:
        """Make the port appear; from now on this thread alone serves it."""
        self._server = server
        self._appear()

    def close(self) -> None:
        """Take the port and its link away; the thread that served has ended."""
        self._server = None
        self._vanish()

    def files(self) -> list[int]:
        """What to wait for: readable when the host has sent something, or has gone."""
        return [self._master] if self._master is not None and self._attached else []

    def next_due_s(self) -> float | None:
        """When the next bytes reach the host, or the device next does something [s]; None when nothing is to come."""
        due = [t for t in (self._line.next_s(), self._device.due_s()) if t is not None]
        return min(due) if due and self._attached else None

    def is_service_due(self, readable: Collection[int]) -> bool:
        """Return whether `serve` has something to do; ``readable``: those of `files` that can be read."""
        if not self._attached or self._requested != self.plugged or self._master in readable:
            return True
        due_s = self.next_due_s()
        return due_s is not None and due_s <= self.clock.now_s()

    def serve(self, announce: Callable[[str], None] = lambda _: None) -> None:
        """Take what the host has sent and hand over what has reached it by now.

        Args:
            announce: called with `terminal` before bytes are handed over.
        """
        try:
            self._serve(announce)
        except Exception:  # noqa: BLE001  a device must never take its port down: the host would wait without a word
            _log.exception("%s: the emulated device failed on this exchange", self.link.name)
            self._line.reset()

    # -- the wire --------------------------------------------------------------------------------------------------

    def _settle(self, *, requested: bool) -> None:
        """Ask the serving thread, which alone opens and closes the terminal, and wait until it is done."""
        self._settled.clear()
        self._requested = requested
        self._wake()
        if self._server is not None and threading.current_thread() is not self._server and self._server.is_alive():
            self._settled.wait(_JOIN_S)

    def _appear(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        name = os.ttyname(slave)
        # The host alone holds the slave side, so that the master sees it come and go.
        os.close(slave)
        self._master, self.terminal = master, name
        self._poller.register(master, select.POLLIN)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(name)
        fresh.replace(self.link)

    def _vanish(self) -> None:
        if self._master is not None:
            self.link.unlink(missing_ok=True)
            self._poller.unregister(self._master)
            os.close(self._master)
            self._master, self.terminal = None, ""
            self._attached = False

    def _serve(self, announce: Callable[[str], None]) -> None:
        if self._requested != self.plugged:
            if self._requested:
                self._appear()
            else:
                self._vanish()
            self._line.reset()
        self._settled.set()
        master = self._master
        if master is None or not self._is_host_there(master):
            return
        line = self._line
        data = self._read(master)
        self.received += len(data)
        now_s = self.clock.now_s()
        due_s = self._device.due_s()
        if data or (due_s is not None and due_s <= now_s):
            line.baud = host_baud(master) or line.baud
            line.queue(self._device.exchange(data, line.arrival_s(len(data), now_s), line.baud))
        piece = line.take_due(self.clock.now_s())
        if piece:
            announce(self.terminal)
            self._write(master, piece)

    def _is_host_there(self, master: int) -> bool:
        """Return whether a host has the port open; greet one that has just opened it."""
        if not self._host_present(master):
            self._attached = False
            self._line.reset()
            return False
        if not self._attached:
            self._attached, self.received = True, 0
            self._line.queue(self._device.opened(self.clock.now_s()))
        return True

    def _host_present(self, master: int) -> bool:
        events = dict(self._poller.poll(0)).get(master, 0)
        return not events & (select.POLLHUP | select.POLLNVAL) or bool(events & select.POLLIN)

    def _read(self, master: int) -> bytes:
        try:
            return os.read(master, _READ_BYTES)
        except OSError as error:
            if error.errno in {errno.EIO, errno.EBADF, errno.EAGAIN}:
                return b""
            raise

    def _write(self, master: int, data: bytes) -> None:
        # A full buffer loses bytes, as the adapter of a host that does not read does; a vanished port loses all.
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(master, data)


class PtyPort(DrivenPort):
    """A port with a thread of its own that serves it at the computer's pace.

    Use as a context manager, or call `start` and `close`.

    Args:
        link, device, paced: as for `DrivenPort`.
        clock: real time, maybe scaled; real time when not given.
    """

    def __init__(self, link: Path, device: WireDevice, *, clock: CellClock | None = None, paced: bool = True) -> None:
        super().__init__(link, device, clock or RealTimeClock(), paced=paced, wake=self._ring)
        self._wake_read, self._wake_write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"pty-{link.name}", daemon=True)

    def start(self) -> PtyPort:
        """Plug in and serve; the link exists when this returns."""
        self.open(self._thread)
        self._thread.start()
        return self

    def close(self) -> None:
        """Stop serving and remove the link. May be called more than once."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._ring()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)
        super().close()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.serve()
            self._wait(self.files(), self._pause_s())

    def _pause_s(self) -> float | None:
        if not self.plugged:
            return None
        if not self.attached:
            return _ABSENT_HOST_POLL_S
        due_s = self.next_due_s()
        if due_s is None:
            # Closing by the host makes the master readable; that a device has something to say again, nothing tells.
            return _QUIET_DEVICE_POLL_S
        return (due_s - self.clock.now_s()) / self.clock.scale

    def _ring(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._wake_write, b"\0")

    def _wait(self, fds: list[int], timeout_s: float | None) -> None:
        # select, not poll: its time-out is in microseconds, and a reply at 3 Mbaud is due within 50.
        ready, _, _ = select.select([*fds, self._wake_read], [], [], None if timeout_s is None else max(0.0, timeout_s))
        if self._wake_read in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake_read, _READ_BYTES)


class Line:
    """Both directions of the cable: when bytes arrive, and which may be handed to the host by when."""

    def __init__(self, paced: bool) -> None:
        self.baud = 9600
        self._paced = paced
        self._rx_busy_until_s = 0.0
        self._tx_busy_until_s = 0.0
        self._pending: deque[Chunk] = deque()

    def reset(self) -> None:
        """Forget what is on its way: the cable was pulled, or nobody listens."""
        self._pending.clear()
        self._rx_busy_until_s = 0.0
        self._tx_busy_until_s = 0.0

    def _duration_s(self, n_bytes: int) -> float:
        return n_bytes * BITS_PER_BYTE / self.baud if self._paced else 0.0

    def arrival_s(self, n_bytes: int, now_s: float) -> float:
        """When the device has received the last of `n_bytes` the host handed over just now."""
        self._rx_busy_until_s = max(self._rx_busy_until_s, now_s) + self._duration_s(n_bytes)
        return self._rx_busy_until_s if n_bytes else now_s

    def queue(self, chunks: Sequence[Chunk]) -> None:
        """Append; each piece's `start_s` becomes the time its last bit has passed."""
        for chunk in chunks:
            burst = max(1, int(_BURST_S * self.baud / BITS_PER_BYTE)) if self._paced else max(1, len(chunk.data))
            start_s = chunk.start_s if self._paced else 0.0
            for begin in range(0, len(chunk.data), burst):
                piece = chunk.data[begin : begin + burst]
                self._tx_busy_until_s = max(self._tx_busy_until_s, start_s) + self._duration_s(len(piece))
                self._pending.append(Chunk(piece, self._tx_busy_until_s))

    def take_due(self, now_s: float) -> bytes:
        """What has reached the host by now."""
        due = b""
        while self._pending and self._pending[0].start_s <= now_s:
            due += self._pending.popleft().data
        return due

    def next_s(self) -> float | None:
        """When the next bytes reach the host [s]; None when none are on their way."""
        return self._pending[0].start_s if self._pending else None


def host_baud(fd: int) -> int | None:
    """The speed [bit/s] set on a terminal, standard or custom; None when it cannot be read."""
    # struct termios2 (asm-generic/termbits.h): four flag words, line discipline, 19 control characters, two speeds.
    buffer = bytearray(44)
    try:
        fcntl.ioctl(fd, _TCGETS2, buffer)
    except OSError:
        return None
    speed = int.from_bytes(buffer[40:44], "little")
    return speed or None
