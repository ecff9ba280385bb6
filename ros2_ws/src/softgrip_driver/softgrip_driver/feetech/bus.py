# SPDX-License-Identifier: Apache-2.0
"""One bus of Feetech servos: transactions that check what comes back, each bounded in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from softgrip_driver.errors import CorruptReplyError, NoReplyError
from softgrip_driver.feetech import packets
from softgrip_driver.feetech.packets import FeetechAnswer
from softgrip_driver.feetech.registers import FeetechItem
from softgrip_driver.serial_bus import SerialBus
from softgrip_driver.usb_adapter import ask_patiently, measure_turnaround

#: [s] that a servo waits before it answers, at most (memory table, return delay (7): 254 units of 2 us)
LONGEST_RETURN_DELAY_S = 0.00051


class FeetechBus(SerialBus):
    """Transactions with the servos on one port. Thread-safe."""

    def read(self, servo_id: int, address: int, size: int, attempts: int = 1) -> FeetechAnswer:
        """Return a block of a servo's memory; raises NoReplyError, CorruptReplyError, PortLostError."""
        return self._ask(servo_id, packets.encode(servo_id, packets.READ, bytes([address, size])), size, attempts)

    def get(self, servo_id: int, item: FeetechItem, attempts: int = 1) -> int:
        """Return the value of an item; raises as `read` does."""
        return item.decode(self.read(servo_id, item.address, item.size, attempts).data)

    def put(self, servo_id: int, item: FeetechItem, value: int, attempts: int = 1) -> None:
        """Write an item; raises as `read` does."""
        parameters = bytes([item.address]) + item.encode(value)
        self._ask(servo_id, packets.encode(servo_id, packets.WRITE, parameters), 0, attempts)

    def ping(self, servo_id: int, attempts: int = 1) -> FeetechAnswer:
        """Return a servo's answer; raises as `read` does."""
        return self._ask(servo_id, packets.encode(servo_id, packets.PING), 0, attempts)

    def turnaround(self, servo_id: int) -> float:
        """Return how long [s] a servo's replies take beyond the time of their bytes; see `measure_turnaround`."""
        question = packets.encode(servo_id, packets.PING)
        wire = self.link.wire_time(len(question) + packets.OVERHEAD)
        return measure_turnaround(lambda extra: self._ask_once(servo_id, question, 0, extra), wire, self.clock)

    def broadcast_ping(self) -> bytes:
        """Return what came after a ping to all, whole or not; raises PortLostError.

        All answer at once, so several servos are heard as noise, or as one where they have one ID.
        """
        with self._lock:
            self.counters.transactions += 1
            self.link.send(packets.encode(packets.BROADCAST, packets.PING))
            return self.link.receive(2 * packets.OVERHEAD, lambda _: False)

    def reset_turns(self, servo_id: int) -> None:
        """Let a servo forget its turns, which switches its torque off; raises as `read` does."""
        self._ask(servo_id, packets.encode(servo_id, packets.RESET_TURNS), 0, 1)

    def sync_read(self, ids: Sequence[int], address: int, size: int) -> dict[int, FeetechAnswer]:
        """Return the same block of several servos, of those that answered; raises PortLostError."""
        question = packets.encode_sync_read(ids, address, size)
        reply_size = len(ids) * (packets.OVERHEAD + size)
        with self._lock:
            self.counters.transactions += 1
            self.link.send(question)
            heard = self.link.receive(
                len(question) + reply_size, lambda so_far: len(so_far) >= reply_size, len(ids) * LONGEST_RETURN_DELAY_S
            )
        answers, damaged = packets.decode(heard)
        found = {one.servo_id: one for one in answers if one.servo_id in ids and len(one.data) == size}
        self.counters.corrupt += damaged
        for missing in set(ids) - set(found):
            self._count_lost(missing)
        return found

    def sync_write(self, item: FeetechItem, values: Mapping[int, int]) -> None:
        """Write an item of several servos; nobody answers. Raises PortLostError."""
        if not values:
            return
        with self._lock:
            self.counters.transactions += 1
            self.link.send(packets.encode_sync_write(item.address, {i: item.encode(v) for i, v in values.items()}))

    def _ask(self, servo_id: int, question: bytes, size: int, attempts: int) -> FeetechAnswer:
        with self._lock:
            return ask_patiently(lambda extra: self._ask_once(servo_id, question, size, extra), attempts, self.link)

    def _ask_once(self, servo_id: int, question: bytes, size: int, extra_wait: float) -> FeetechAnswer:
        reply_size = packets.OVERHEAD + size
        with self._lock:
            self.counters.transactions += 1
            self.link.send(question)
            heard = self.link.receive(len(question) + reply_size, lambda so_far: len(so_far) >= reply_size, extra_wait)
        answers, _ = packets.decode(heard)
        for one in answers:
            if one.servo_id == servo_id and len(one.data) == size:
                return one
        where = f"port {self.link.path}, ID {servo_id}"
        if heard:
            self.counters.corrupt += 1
            raise CorruptReplyError(f"{where}: expected a reply of {reply_size} bytes, found {heard[:32].hex(' ')}")
        self._count_lost(servo_id)
        raise NoReplyError(f"{where}: expected a reply, found none; check power, cable, ID and baud rate")
