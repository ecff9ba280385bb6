# SPDX-License-Identifier: Apache-2.0
"""Damiao motors behind one serial CAN adapter: questions and orders for several at once, each bounded in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from softgrip_driver.damiao import frames, slcan
from softgrip_driver.damiao.frames import Feedback, Ranges, Register
from softgrip_driver.damiao.slcan import Frame
from softgrip_driver.errors import NoReplyError, PortLostError
from softgrip_driver.serial_bus import SerialBus
from softgrip_time import Clock


class DamiaoBus(SerialBus):
    """Transactions with the motors behind one adapter. Thread-safe.

    Args:
        path: device path of the adapter.
        baud: [1/s] of its serial line; adapters on USB take any.
        reply_margin: [s] allowed for a reply beyond the time its bytes need.
        ranges: of the motors' feedback.
        clock: that its waits are on; the computer's where none is given.
    """

    def __init__(self, path: str, baud: int, reply_margin: float, ranges: Ranges, clock: Clock | None = None) -> None:
        super().__init__(path, baud, reply_margin, clock)
        self.ranges = ranges

    def open(self) -> None:
        """Open port and channel; raises PortLostError."""
        with self._lock:
            self.link.open()
            self.link.send(slcan.OPEN_AT_1_MBIT)
            self.link.receive(2 * len(slcan.OPEN_AT_1_MBIT), lambda heard: heard.count(slcan.END) >= 3)

    def close(self) -> None:
        """Close channel and port; never raises."""
        with self._lock:
            try:
                if self.link.is_open:
                    self.link.send(slcan.CLOSE)
            except PortLostError:
                pass  # gone already: nothing is left to close
            self.link.close()

    def feedbacks(self, orders: Sequence[Frame], motor_ids: Sequence[int]) -> dict[int, Feedback]:
        """Send an order to each of some motors; return the feedback of those that answered. Raises PortLostError."""
        found = frames.by_motor(self._exchange(orders, lambda seen: self._has_all(seen, motor_ids)), self.ranges)
        for missing in set(motor_ids) - set(found):
            self._count_lost(missing)
        return {one: found[one] for one in motor_ids if one in found}

    def order(self, order: Frame, motor_id: int, attempts: int = 1) -> Feedback:
        """Send an order until it is answered; raises NoReplyError or PortLostError."""
        for _ in range(attempts):
            found = self.feedbacks([order], [motor_id])
            if found:
                return found[motor_id]
        raise self._silent(motor_id)

    def send(self, orders: Sequence[Frame]) -> None:
        """Send orders whose answers nobody waits for; raises PortLostError."""
        if orders:
            with self._lock:
                self.counters.transactions += 1
                self.link.send(slcan.encode(orders))

    def get(self, motor_id: int, register: Register, attempts: int = 1) -> float:
        """Return a register; raises NoReplyError or PortLostError."""
        return self._asked(frames.read_register(motor_id, register), motor_id, register, attempts)

    def put(self, motor_id: int, register: Register, value: float, attempts: int = 1) -> float:
        """Set a register until the power goes; return what it is now. Raises NoReplyError or PortLostError."""
        return self._asked(frames.write_register(motor_id, register, value), motor_id, register, attempts)

    def _asked(self, question: Frame, motor_id: int, register: Register, attempts: int) -> float:
        def value_of(seen: Sequence[Frame]) -> float | None:
            values = (frames.register_value(one, motor_id, register) for one in seen)
            return next((value for value in values if value is not None), None)

        for _ in range(attempts):
            value = value_of(self._exchange([question], lambda seen: value_of(seen) is not None))
            if value is not None:
                return value
            self._count_lost(motor_id)
        raise self._silent(motor_id)

    def _exchange(self, orders: Sequence[Frame], is_enough: Callable[[Sequence[Frame]], bool]) -> list[Frame]:
        with self._lock:
            self.counters.transactions += 1
            question = slcan.encode(orders)
            self.link.send(question)
            size = 2 * len(question) + len(orders) * slcan.FRAME_LINE
            heard = self.link.receive(size, lambda so_far: is_enough(slcan.decode(so_far)[0]))
        seen, damaged = slcan.decode(heard)
        self.counters.corrupt += damaged
        return seen

    def _has_all(self, seen: Sequence[Frame], motor_ids: Sequence[int]) -> bool:
        return set(motor_ids) <= set(frames.by_motor(seen, self.ranges))

    def _silent(self, motor_id: int) -> NoReplyError:
        return NoReplyError(
            f"port {self.link.path}, motor {motor_id}: expected an answer, found none; check power, both ends' "
            "terminators, and that the motor is set to 1 Mbit/s"
        )
