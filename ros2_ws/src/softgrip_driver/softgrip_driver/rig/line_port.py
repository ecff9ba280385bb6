# SPDX-License-Identifier: Apache-2.0
"""A serial port that speaks lines: bounded waits on a monotonic clock, no stale bytes."""

from __future__ import annotations

import termios
from pathlib import Path

import serial

from softgrip_driver.errors import DeviceNotFoundError, NoReplyError, PortLostError
from softgrip_time import Clock, WallClock

#: [s] that the system may take a line for; an adapter that hangs counts as gone.
WRITE_TIMEOUT_S = 1.0
#: What pyserial and the tty layer raise when a device goes away.
_GONE = (OSError, termios.error, TypeError, ValueError)
#: Longer than any line of these devices: noise at a wrong baud rate must not fill the memory.
_LONGEST_LINE = 4096


class LinePort:
    """One port, opened for this process alone.

    Args:
        path: device path.
        baud: [1/s], 8N1.
        reply_time: [s] to wait for an answer.
        end: of a line.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(
        self, path: str, baud: int, reply_time: float = 0.5, end: bytes = b"\n", clock: Clock | None = None
    ) -> None:
        self.clock = clock or WallClock()
        self.path = path
        self.reply_time = reply_time
        self._baud = baud
        self._serial: serial.Serial | None = None
        self._pending = b""
        self._end = end
        #: what was heard last is not the end of a line
        self._is_cut = True

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`, also when the device has gone since."""
        return self._serial is not None

    def open(self) -> None:
        """Open the port.

        Raises:
            DeviceNotFoundError: no such path.
            PortLostError: taken by another process, no permission, or no serial port.
        """
        self.close()
        if not Path(self.path).exists():
            raise DeviceNotFoundError(
                f"port {self.path}: expected a serial port, found nothing; check cable, power and the port parameter"
            )
        try:
            self._serial = serial.Serial(
                port=self.path, baudrate=self._baud, timeout=0, exclusive=True, write_timeout=WRITE_TIMEOUT_S
            )
            self.clock.attach(self._serial.fileno())
            self._serial.reset_input_buffer()
        except _GONE as error:
            raise PortLostError(
                f"port {self.path}: expected a free serial port, found: {error}; check permissions (group dialout) and "
                "that no other program uses it"
            ) from error
        self._pending, self._is_cut = b"", True

    def close(self) -> None:
        """Close the port; never raises."""
        port, self._serial = self._serial, None
        if port is not None:
            try:
                self.clock.detach(port.fileno())
                port.close()
            except _GONE:
                # The device is gone: nothing is left to close.
                self._pending = b""

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            PortLostError: the port is gone.
        """
        port = self._port()
        try:
            self.clock.count_written(port.fileno(), port.write(data) or 0)
        except _GONE as error:
            raise self._lost(error) from error

    def read_next_line(self, timeout: float | None = None) -> bytes:
        """Return the first line that begins after this call, as `read_line`; what was said before is thrown away."""
        self.drain()
        if self._is_cut:
            # The rest of a line that was cut into may look like a whole one.
            self.read_line(timeout)
        return self.read_line(timeout)

    def read_line(self, timeout: float | None = None, length: int = 0) -> bytes:
        """Return the next line without its end, waiting up to ``timeout`` [s] (default `reply_time`).

        Args:
            timeout: [s]
            length: [byte] of an answer that has no end; 0: it has one.

        Raises:
            NoReplyError: no complete line in time; says what came.
            PortLostError: the port is gone.
        """
        end = self.clock.now_s() + (self.reply_time if timeout is None else timeout)
        while True:
            if 0 < length <= len(self._pending):
                line, self._pending = self._pending[:length], self._pending[length:]
                return line
            line, found, rest = self._pending.partition(self._end)
            if found and not length:
                self._pending = rest
                return line.strip(b"\r\n")
            remaining = end - self.clock.now_s()
            if remaining <= 0.0 or not self._receive(remaining):
                heard = f"{self._pending[:40]!r}" if self._pending else "nothing"
                raise NoReplyError(
                    f"port {self.path}: expected a line within {self.reply_time:g} s, found {heard}; "
                    "check power, cable and baud rate"
                )

    def drain(self, quiet: float = 0.0) -> int:
        """Throw away what came in until nothing comes for ``quiet`` [s], at most a second; return the bytes thrown.

        Raises:
            PortLostError: the port is gone.
        """
        thrown = len(self._pending)
        end = self.clock.now_s() + 1.0
        self._pending = b""
        while self.clock.now_s() < end and self._receive(quiet):
            thrown += len(self._pending)
            self._pending = b""
        return thrown

    def _receive(self, timeout: float) -> bool:
        port = self._port()
        try:
            ready = self.clock.wait_readable((port.fileno(),), self.clock.now_s() + timeout)
            data = port.read(_LONGEST_LINE) if ready else b""
        except _GONE as error:
            raise self._lost(error) from error
        if ready and not data:
            raise self._lost(OSError("the device hung up"))
        self._pending = (self._pending + data)[-_LONGEST_LINE:]
        self._is_cut = not self._pending.endswith(self._end) if data else self._is_cut
        return bool(data)

    def _port(self) -> serial.Serial:
        if self._serial is None:
            raise PortLostError(f"port {self.path}: expected an open port, found it closed; configure the rig again")
        return self._serial

    def _lost(self, error: BaseException) -> PortLostError:
        return PortLostError(f"port {self.path}: the device went away ({error}); plug it in again, then continue")
