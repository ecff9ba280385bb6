# SPDX-License-Identifier: Apache-2.0
"""The serial port under dynamixel-sdk: bounded waits on a monotonic clock, no busy loop, no stale bytes.

dynamixel-sdk waits at least 34 ms for a reply, on the wall clock, polling; and 4.0.3, which ROS 2 Jazzy ships, takes a
reply that arrives late as the answer to the next read. Overriding the six methods below repairs all of that for every
version of the SDK.
"""

from __future__ import annotations

import os
import select
import termios
from contextlib import suppress
from typing import Any

import serial
from dynamixel_sdk import PortHandler

from softgrip_driver.errors import ConfigurationError, PortLostError
from softgrip_driver.usb_adapter import drain, naming_advice, request_low_latency
from softgrip_time import Clock

#: [s] that the system may take a packet for. An adapter that hangs with its flow stopped would hold the bus thread for
#: ever: it counts as gone. No packet is longer than 1 kB, which takes 0.2 s at 57,600 baud.
WRITE_TIMEOUT_S = 0.5
#: 8N1: start bit, eight data bits, stop bit
BITS_PER_BYTE = 10
#: what pyserial and the tty layer raise when the device goes away (termios.error is no OSError; a closed Serial raises
#: TypeError from its missing file descriptor)
PORT_ERRORS = (OSError, termios.error, TypeError, ValueError)


class _PatientSerial(serial.Serial):
    """A port that hangs only where it does not take bytes: for pyserial, so does one of a computer that pauses."""

    def write(self, data: Any, /) -> int:
        """Write all bytes; SerialTimeoutException when the port has taken none for ``write_timeout`` [s]."""
        port, left = self.fileno(), memoryview(data)
        while left:
            if not select.select((), (port,), (), self.write_timeout)[1]:
                raise serial.SerialTimeoutException("Write timeout")
            with suppress(BlockingIOError):
                left = left[os.write(port, left) :]
        return len(data)


class BusPort(PortHandler):  # type: ignore[misc]  # dynamixel-sdk has no types
    """A PortHandler whose waits end when the reply can no longer come.

    Args:
        port_name: device path.
        baud: [1/s]
        reply_margin: [s] allowed beyond the time that the bytes need: return delay, USB, scheduling.
        clock: that its waits are on.
    """

    def __init__(self, port_name: str, baud: int, reply_margin: float, clock: Clock) -> None:
        super().__init__(port_name)
        self.clock = clock
        self.is_open: bool = False
        self.ser: Any = None
        self.baudrate = baud
        self.reply_margin = reply_margin
        #: [s] beyond that, for what the adapter keeps back
        self.lateness = 0.0
        #: [s] when something was written last
        self.last_traffic = 0.0
        self._deadline = 0.0

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802  the SDK's name
        """Open the port for this process alone."""
        if self.is_open:
            self.closePort()
        self.ser = _PatientSerial(
            port=self.port_name, baudrate=cflag_baud, bytesize=serial.EIGHTBITS, timeout=0, exclusive=True,
            write_timeout=WRITE_TIMEOUT_S,
        )  # fmt: skip
        request_low_latency(self.ser)
        self.is_open = True
        self.is_using = False
        self.clock.attach(self.ser.fd)
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 1000.0 * BITS_PER_BYTE / cflag_baud
        return True

    def clearPort(self) -> None:  # noqa: N802  the SDK's name
        """Throw away what came in before the transaction that starts now (4.0.3 does not)."""
        self.ser.reset_input_buffer()

    def writePort(self, packet: Any) -> int:  # noqa: N802  the SDK's name
        """Send bytes; every servo on the bus hears them, and its watchdog is fed."""
        self.last_traffic = self.clock.now_s()
        written: int = self.ser.write(bytes(packet))
        self.clock.count_written(self.ser.fd, written)
        return written

    def readPort(self, length: int) -> bytes:  # noqa: N802  the SDK's name
        """Return up to ``length`` bytes, waiting for the first of them until the deadline."""
        if length <= 0:
            return b""
        if self.clock.now_s() < self._deadline:
            self.clock.wait_readable((self.ser.fd,), self._deadline)
        data: bytes = self.ser.read(length)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802  the SDK's name
        """Allow the time that ``packet_length`` bytes need plus the margin."""
        self.allow(packet_length)

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802  the SDK's name
        """Allow ``msec`` milliseconds."""
        self._deadline = self.clock.now_s() + msec * 1e-3

    def isPacketTimeout(self) -> bool:  # noqa: N802  the SDK's name
        """Return whether the deadline has passed."""
        return self.clock.now_s() >= self._deadline

    def allow(self, length: int, extra: float = 0.0) -> None:
        """Set the deadline of a reply of ``length`` bytes, ``extra`` [s] beyond the usual time."""
        usual = length * self.tx_time_per_byte * 1e-3 + self.reply_margin + self.lateness
        self._deadline = self.clock.now_s() + usual + extra

    def open(self) -> None:
        """Open the port.

        Raises:
            ConfigurationError: the baud rate is none the SDK knows.
            PortLostError: the port is missing, taken by another process, or no serial port.
        """
        try:
            opened = self.setBaudRate(self.baudrate)
        except PORT_ERRORS as error:
            advice = naming_advice(self.port_name)
            raise PortLostError(
                f"port {self.port_name}: expected a free serial port, found: {error}; "
                "check cable, power, permissions (group dialout) and that no other program uses it"
                + (f"; {advice}" if advice else "")
            ) from error
        if not opened:
            raise ConfigurationError(
                f"port {self.port_name}: expected a baud rate that dynamixel-sdk knows, found {self.baudrate}"
            )

    def close(self) -> None:
        """Close the port; never raises."""
        if self.ser is not None:
            try:
                self.clock.detach(self.ser.fd)
                self.ser.close()
            except PORT_ERRORS:
                # Gone already: nothing is left to close.
                self.ser = None
        self.is_open = False
        self.is_using = False

    def drain(self, quiet: float, limit: float) -> int:
        """Discard input until none came for ``quiet`` [s], at most ``limit`` [s]; return the bytes discarded."""
        return drain(self.ser, self.clock, quiet, limit)
