# SPDX-License-Identifier: Apache-2.0
"""What buses behind a plain serial port have in common: the port, its clock, and what was seen."""

from __future__ import annotations

import termios
import threading
from collections.abc import Callable

import serial

from softgrip_driver.errors import PortLostError
from softgrip_driver.tendon.backend import Counters
from softgrip_driver.usb_adapter import LATENCY_SHARE, drain, naming_advice, request_low_latency
from softgrip_time import Clock, WallClock

#: [s] that the system may take a packet for; an adapter that hangs counts as gone
WRITE_TIMEOUT_S = 0.5
#: 8N1: start bit, eight data bits, stop bit
BITS_PER_BYTE = 10
#: what pyserial and the tty layer raise when a device goes away
_GONE = (OSError, termios.error, TypeError, ValueError)
_CHUNK = 4096


class SerialLink:
    """One port, opened for this process alone.

    Args:
        path: device path.
        baud: [1/s], 8N1.
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(self, path: str, baud: int, reply_margin: float, clock: Clock | None = None) -> None:
        self.clock = clock or WallClock()
        self.path = path
        self.baud = baud
        self.reply_margin = reply_margin
        #: [s] beyond that, for what the adapter keeps back
        self.lateness = 0.0
        self._serial: serial.Serial | None = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._serial is not None

    def open(self) -> None:
        """Open the port; raises PortLostError."""
        self.close()
        try:
            port = serial.Serial(
                port=self.path, baudrate=self.baud, timeout=0, exclusive=True, write_timeout=WRITE_TIMEOUT_S
            )
            request_low_latency(port)
            self.clock.attach(port.fileno())
            port.reset_input_buffer()
        except _GONE as error:
            advice = naming_advice(self.path)
            raise PortLostError(
                f"port {self.path}: expected a free serial port, found: {error}; check cable, power, permissions "
                "(group dialout) and that no other program uses it" + (f"; {advice}" if advice else "")
            ) from error
        self._serial = port

    def close(self) -> None:
        """Close the port; never raises."""
        if self._serial is None:
            return
        try:
            self.clock.detach(self._serial.fileno())
            self._serial.close()
        except _GONE:
            pass  # gone already: nothing is left to close
        self._serial = None

    def send(self, data: bytes) -> bytes:
        """Send a packet; return what came in before, which is no answer to it. Raises PortLostError."""
        before = b""
        try:
            port = self._port()
            while piece := port.read(_CHUNK):
                before += piece
            self.clock.count_written(port.fileno(), port.write(data) or 0)
        except _GONE as error:
            raise self._lost(error) from error
        return before

    def wire_time(self, size: int) -> float:
        """Return the time [s] that so many bytes need."""
        return size * BITS_PER_BYTE / self.baud

    def reply_deadline(self, size: int, extra_wait: float = 0.0) -> float:
        """Return when [s, of the clock] an answer can no longer come, to what is sent now.

        Args:
            size: bytes that question and answer have.
            extra_wait: [s] beyond the usual time.
        """
        return self.clock.now_s() + self.wire_time(size) + self.reply_margin + self.lateness + extra_wait

    def receive(self, size: int, is_complete: Callable[[bytes], bool], extra_wait: float = 0.0) -> bytes:
        """Return what came in until it is complete, or can no longer come; raises PortLostError.

        Args:
            size: bytes that question and answer have, for the time they take.
            is_complete: of the bytes so far.
            extra_wait: [s] beyond the usual time.
        """
        until = self.reply_deadline(size, extra_wait)
        heard = b""
        try:
            port = self._port()
            while not is_complete(heard):
                if not self.clock.wait_readable((port.fileno(),), until):
                    break
                heard += port.read(_CHUNK)
        except _GONE as error:
            raise self._lost(error) from error
        return heard

    def drain(self, quiet: float, limit: float) -> int:
        """Discard input until none came for ``quiet`` [s], at most ``limit`` [s]; return how many bytes.

        Raises:
            PortLostError: it went away.
        """
        try:
            return drain(self._port(), self.clock, quiet, limit)
        except _GONE as error:
            raise self._lost(error) from error

    def _port(self) -> serial.Serial:
        if self._serial is None:
            raise OSError("it is closed")
        return self._serial

    def _lost(self, error: Exception) -> PortLostError:
        self.close()
        return PortLostError(
            f"port {self.path}: expected a serial port that stays, found: {error}; plug the adapter in again"
        )


class SerialBus:
    """One port and what went over it; transactions are a subclass's.

    Args:
        path: device path.
        baud: [1/s]
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(self, path: str, baud: int, reply_margin: float, clock: Clock | None = None) -> None:
        self.link = SerialLink(path, baud, reply_margin, clock)
        self.clock = self.link.clock
        self.counters = Counters()
        self._lock = threading.RLock()

    @property
    def is_open(self) -> bool:
        """Whether the port is there."""
        return self.link.is_open

    @property
    def port_name(self) -> str:
        """Device path of the port."""
        return self.link.path

    def open(self) -> None:
        """Open the port; raises PortLostError."""
        self.link.open()

    def close(self) -> None:
        """Close the port; never raises."""
        self.link.close()

    def allow_lateness(self, turnaround: float) -> None:
        """From now on wait for replies as long as an adapter keeps them back that took so long [s]."""
        self.link.lateness = LATENCY_SHARE * turnaround

    def _count_lost(self, device_id: int) -> None:
        self.counters.lost += 1
        self.counters.lost_by_id[device_id] = self.counters.lost_by_id.get(device_id, 0) + 1
