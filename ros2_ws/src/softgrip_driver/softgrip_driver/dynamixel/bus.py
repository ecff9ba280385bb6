# SPDX-License-Identifier: Apache-2.0
"""One Dynamixel bus: transactions over dynamixel-sdk that check what comes back and always leave the bus usable.

What is added to the SDK: stuffing that works (stuffing.py); waits that end (port.py); one lock; input flushed before
each transaction; ID, length and error byte of every reply checked; each servo's own answer to a sync read (the SDK
throws all away when one is missing, and the error bytes always); a port that can be reopened after it went away.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS

from softgrip_driver.dynamixel.port import BITS_PER_BYTE, PORT_ERRORS, BusPort
from softgrip_driver.dynamixel.registers import ALERT_BIT, STATUS_ERRORS, ControlItem
from softgrip_driver.dynamixel.stuffing import PacketHandler
from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, NoReplyError, PortLostError
from softgrip_driver.tendon.backend import Counters
from softgrip_driver.usb_adapter import LATENCY_SHARE, ask_patiently, measure_turnaround
from softgrip_time import Clock, WallClock

BROADCAST = 0xFE
_PING, _READ, _WRITE, _REBOOT, _CLEAR = 0x01, 0x02, 0x03, 0x08, 0x10
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A
#: status packet without parameters: header 4, ID, length 2, instruction, error, CRC 2
_STATUS_OVERHEAD = 11
#: an instruction without parameters: the same without the error
_INSTRUCTION_OVERHEAD = 10
#: model number and firmware
_PING_BYTES = 3
#: reads of the measured items, from Realtime Tick to Present Temperature, that tell whether two servos answer at once
SHARED_READS, SHARED_BYTES = 5, 27
_MEASURED = (120).to_bytes(2, "little") + SHARED_BYTES.to_bytes(2, "little")
_ID_AT, _LENGTH_AT, _ERROR_AT, _DATA_AT = 4, 5, 8, 9


@dataclass(frozen=True)
class BusReply:
    """One checked status packet.

    Attributes:
        servo_id: who answered.
        alert: the servo's hardware error status is not zero; the data are good all the same.
        code: low seven bits of the error byte; 0 = done.
        data: parameters without the error byte.
    """

    servo_id: int
    alert: bool
    code: int
    data: bytes


class Bus:
    """Transactions with the servos on one port. Thread-safe; every call is bounded in time.

    Args:
        port_name: device path.
        baud: [1/s]
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(self, port_name: str, baud: int, reply_margin: float = 0.004, clock: Clock | None = None) -> None:
        self.clock = clock or WallClock()
        self.port = BusPort(port_name, baud, reply_margin, self.clock)
        self.counters = Counters()
        self._handler = PacketHandler()
        self._lock = threading.RLock()

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self.port.is_open)

    @property
    def port_name(self) -> str:
        """Device path of the port."""
        return str(self.port.port_name)

    def open(self) -> None:
        """Open the port; raises PortLostError or ConfigurationError."""
        with self._lock:
            self.port.open()

    def close(self) -> None:
        """Close the port; never raises."""
        with self._lock:
            self.port.close()

    def ping(self, servo_id: int, attempts: int = 1) -> tuple[int, int]:
        """Return (model number, firmware version) of a servo."""
        reply = self._exchange(servo_id, _PING, b"", _PING_BYTES, attempts)
        return int.from_bytes(reply.data[:2], "little"), reply.data[2]

    def turnaround(self, servo_id: int) -> float:
        """Return how long [s] a servo's replies take beyond the time of their bytes; see `measure_turnaround`."""
        wire = (_INSTRUCTION_OVERHEAD + _STATUS_OVERHEAD + _PING_BYTES) * BITS_PER_BYTE / self.port.baudrate
        with self._lock:
            return measure_turnaround(
                lambda extra: self._exchange_once(servo_id, _PING, b"", _PING_BYTES, extra), wire, self.clock
            )

    def allow_lateness(self, turnaround: float) -> None:
        """From now on wait for replies as long as an adapter keeps them back that took so long [s]."""
        self.port.lateness = LATENCY_SHARE * turnaround

    def broadcast_ping(self, wait: float = 0.3) -> dict[int, tuple[int, int]]:
        """Return {ID: (model number, firmware)} of every servo that answers within ``wait`` [s]."""
        found: dict[int, tuple[int, int]] = {}
        with self._lock, self._guard():
            self._send(BROADCAST, _PING, b"")
            self.port.allow(0, wait)
            while not self.port.isPacketTimeout():
                reply = self._receive()
                if reply is not None and len(reply.data) == 3:
                    found[reply.servo_id] = (int.from_bytes(reply.data[:2], "little"), reply.data[2])
        return found

    def is_shared(self, servo_id: int) -> bool:
        """Return whether several servos seem to answer to an ID: pings are alike, but what they measure is not."""
        damaged = 0
        for _ in range(SHARED_READS):
            try:
                self._exchange(servo_id, _READ, _MEASURED, SHARED_BYTES, 1)
            except CorruptReplyError:
                damaged += 1
            except (NoReplyError, DeviceRefusedError):
                return False
        return 2 * damaged > SHARED_READS

    def read(self, servo_id: int, item: ControlItem, attempts: int = 1) -> int:
        """Return the value of an item."""
        return item.decode(self.read_bytes(servo_id, item.address, item.size, attempts).data)

    def read_bytes(self, servo_id: int, address: int, size: int, attempts: int = 1) -> BusReply:
        """Return ``size`` bytes of the control table with the alert flag."""
        parameters = address.to_bytes(2, "little") + size.to_bytes(2, "little")
        return self._exchange(servo_id, _READ, parameters, size, attempts)

    def write(self, servo_id: int, item: ControlItem, value: int, attempts: int = 1) -> None:
        """Write an item and wait for the servo's word that it did."""
        self._exchange(servo_id, _WRITE, item.address.to_bytes(2, "little") + item.encode(value), 0, attempts)

    def reboot(self, servo_id: int) -> None:
        """Reboot a servo; it answers at once and is silent afterwards for some tenths of a second."""
        self._exchange(servo_id, _REBOOT, b"", 0, 1)

    def sync_write(self, item: ControlItem, values: Mapping[int, int]) -> None:
        """Write one item of several servos in one packet; no servo answers."""
        if not values:
            return
        parameters = item.address.to_bytes(2, "little") + item.size.to_bytes(2, "little")
        parameters += b"".join(bytes((servo_id,)) + item.encode(value) for servo_id, value in values.items())
        with self._lock, self._guard():
            self.counters.transactions += 1
            self._send(BROADCAST, _SYNC_WRITE, parameters)

    def push_through(self, seconds: float) -> None:
        """Send zeros for a while [s]: where a length was damaged, receivers wait for the rest of a packet."""
        with self._lock, self._guard():
            self.port.writePort(bytes(int(seconds * self.port.baudrate / BITS_PER_BYTE)))

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, BusReply]:
        """Return the answers of those servos that answered, in one transaction; silent ones are missing."""
        requested = set(servo_ids)
        replies: dict[int, BusReply] = {}
        with self._lock, self._guard():
            self.counters.transactions += 1
            self._send(BROADCAST, _SYNC_READ, self._group(servo_ids, address, size))
            self.port.allow(len(servo_ids) * (_STATUS_OVERHEAD + size))
            while requested:
                reply = self._receive()
                if reply is None and self.port.isPacketTimeout():
                    break
                if reply is not None and reply.servo_id in requested and len(reply.data) == size:
                    replies[reply.servo_id] = reply
                    requested.discard(reply.servo_id)
        self._count_lost(requested)
        return replies

    def fast_sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, BusReply]:
        """Return all answers out of one common status packet, or none when any servo of the chain is silent."""
        expected = 8 + len(servo_ids) * (size + 4)
        with self._lock, self._guard():
            self.counters.transactions += 1
            self._send(BROADCAST, _FAST_SYNC_READ, self._group(servo_ids, address, size))
            self.port.allow(expected)
            packet, result = self._handler.rxPacket(self.port, True)
        if result != COMM_SUCCESS or len(packet) != expected or packet[_ID_AT] != BROADCAST:
            self._count_lost(servo_ids)
            if result not in (COMM_SUCCESS, COMM_RX_TIMEOUT):
                self.counters.corrupt += 1
            return {}
        replies: dict[int, BusReply] = {}
        for index, servo_id in enumerate(servo_ids):
            start = _ERROR_AT + index * (size + 4)
            if packet[start + 1] != servo_id:
                self.counters.corrupt += 1
                return {}
            error = packet[start]
            replies[servo_id] = BusReply(
                servo_id, bool(error & ALERT_BIT), error & 0x7F, bytes(packet[start + 2 : start + 2 + size])
            )
        return replies

    def _exchange(self, servo_id: int, instruction: int, parameters: bytes, size: int, attempts: int) -> BusReply:
        """Send an instruction until a whole answer came, at most ``attempts`` times."""
        with self._lock, self._guard():
            return ask_patiently(
                lambda extra: self._exchange_once(servo_id, instruction, parameters, size, extra), attempts, self.port
            )

    def _exchange_once(
        self, servo_id: int, instruction: int, parameters: bytes, size: int, extra_wait: float
    ) -> BusReply:
        corrupt = False
        with self._guard():
            self.counters.transactions += 1
            self._send(servo_id, instruction, parameters)
            self.port.allow(_STATUS_OVERHEAD + size, extra_wait)
            while True:
                reply = self._receive()
                if reply is None and self.port.isPacketTimeout():
                    break
                corrupt = corrupt or reply is None
                if reply is None or reply.servo_id != servo_id:
                    continue
                if reply.code:
                    self.counters.refused += 1
                    reason = STATUS_ERRORS.get(reply.code, "unknown code")
                    raise DeviceRefusedError(
                        f"servo {servo_id} refused instruction 0x{instruction:02x}: code {reply.code}, {reason}",
                        reply.code,
                    )
                if len(reply.data) == size:
                    return reply
                corrupt = True
        self._count_lost((servo_id,))
        if corrupt:
            raise CorruptReplyError(
                f"servo {servo_id}: expected a status packet with {size} bytes of data, found damaged bytes; "
                "check wiring, termination and that each ID is used once"
            )
        raise NoReplyError(
            f"servo {servo_id}: expected a reply within {(self.port.reply_margin + self.port.lateness) * 1e3:.1f} ms, "
            "found none; check power, cable, ID and baud rate"
        )

    def _send(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        length = len(parameters) + 3
        packet = [0, 0, 0, 0, servo_id, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]
        self.port.is_using = False
        result = self._handler.txPacket(self.port, packet)
        if result != COMM_SUCCESS:
            raise PortLostError(f"port {self.port.port_name}: {self._handler.getTxRxResult(result)}")

    def _receive(self) -> BusReply | None:
        """Return the next whole status packet, or None when it is damaged or the deadline has passed."""
        packet, result = self._handler.rxPacket(self.port, False)
        if result != COMM_SUCCESS:
            if result != COMM_RX_TIMEOUT:
                self.counters.corrupt += 1
            return None
        length = packet[_LENGTH_AT] | packet[_LENGTH_AT + 1] << 8
        if length < 4:
            self.counters.corrupt += 1
            return None
        error = packet[_ERROR_AT]
        return BusReply(
            packet[_ID_AT], bool(error & ALERT_BIT), error & 0x7F, bytes(packet[_DATA_AT : _DATA_AT + length - 4])
        )

    def _guard(self) -> _PortGuard:
        return _PortGuard(self.port)

    def _count_lost(self, servo_ids: Sequence[int] | set[int]) -> None:
        for servo_id in servo_ids:
            self.counters.lost += 1
            self.counters.lost_by_id[servo_id] = self.counters.lost_by_id.get(servo_id, 0) + 1

    @staticmethod
    def _group(servo_ids: Sequence[int], address: int, size: int) -> bytes:
        return address.to_bytes(2, "little") + size.to_bytes(2, "little") + bytes(servo_ids)


class _PortGuard:
    """Turns what a vanished port raises into PortLostError and frees the SDK's busy flag whatever happens."""

    def __init__(self, port: BusPort) -> None:
        self._port = port

    def __enter__(self) -> None:
        if not self._port.is_open:
            raise PortLostError(f"port {self._port.port_name} is closed")

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._port.is_using = False
        if isinstance(error, PORT_ERRORS) and not isinstance(error, (PortLostError, DeviceRefusedError)):
            self._port.close()
            raise PortLostError(
                f"port {self._port.port_name} went away ({error}); plug the adapter in again, it is reopened by itself"
            ) from error
