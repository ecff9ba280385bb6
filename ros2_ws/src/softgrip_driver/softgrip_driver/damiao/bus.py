# SPDX-License-Identifier: Apache-2.0
"""Damiao motors behind one serial CAN adapter: questions and orders for several at once, each bounded in time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TypeVar

from softgrip_driver.damiao import frames, slcan
from softgrip_driver.damiao.frames import Feedback, Ranges, Register
from softgrip_driver.damiao.slcan import Frame
from softgrip_driver.errors import NoReplyError, PortLostError
from softgrip_driver.serial_bus import SerialBus
from softgrip_driver.usb_adapter import ask_patiently, measure_turnaround
from softgrip_time import Clock

Result = TypeVar("Result")


class DamiaoBus(SerialBus):
    """Transactions with the motors behind one adapter. Thread-safe.

    A motor answers every order with a feedback, and nothing in it names the order. Those that nobody waits for are
    counted, so that one that an adapter has kept back is never taken for the answer to what was asked since.

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
        #: feedbacks that are still to come of orders that nobody waits for, by motor, and [s] until when they may
        self._owed: Counter[int] = Counter()
        self._owed_until = 0.0
        #: the last of those that came, by motor
        self._at_order: dict[int, Feedback] = {}
        #: a line whose end has not come
        self._begun = b""

    def open(self) -> None:
        """Open port and channel; raises PortLostError."""
        with self._lock:
            self._owed.clear()
            self._begun = b""
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

    def turnaround(self, motor_id: int) -> float:
        """Return how long [s] a motor's answers take beyond the time of their bytes; see `measure_turnaround`."""
        question = [frames.refresh(motor_id)]
        return measure_turnaround(
            lambda extra: self._order_once(question[0], motor_id, extra),
            self.link.wire_time(_bytes_of(question)),
            self.clock,
        )

    def feedbacks(
        self, orders: Sequence[Frame], motor_ids: Sequence[int], extra_wait: float = 0.0
    ) -> dict[int, Feedback]:
        """Send an order to each of some motors; return the feedback of those that answered.

        Args:
            orders: one for each motor.
            motor_ids: of the motors.
            extra_wait: [s] beyond the usual time.

        Raises:
            PortLostError: the port went away.
        """
        found = self._exchange(orders, self._feedbacks_of, lambda seen: set(motor_ids) <= set(seen), extra_wait)
        for missing in set(motor_ids) - set(found):
            self._count_lost(missing)
        return {one: found[one] for one in motor_ids if one in found}

    def order(self, order: Frame, motor_id: int, attempts: int = 1) -> Feedback:
        """Send an order until it is answered; raises NoReplyError or PortLostError."""
        with self._lock:
            return ask_patiently(lambda extra: self._order_once(order, motor_id, extra), attempts, self.link)

    def send(self, orders: Sequence[Frame]) -> None:
        """Send orders whose answers nobody waits for; raises PortLostError."""
        if orders:
            with self._lock:
                self.counters.transactions += 1
                self._settle(self.link.send(slcan.encode(orders)))
                self._owed.update(map(frames.addressee, orders))
                self._owed_until = self.link.reply_deadline(_bytes_of(orders))

    def take_order_feedbacks(self) -> dict[int, Feedback]:
        """Return what motors answered to `send` since this was called last: what they saw before they obeyed."""
        with self._lock:
            taken, self._at_order = self._at_order, {}
        return taken

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

        def ask_once(extra_wait: float) -> float:
            value = self._exchange([question], value_of, lambda found: found is not None, extra_wait)
            if value is None:
                self._count_lost(motor_id)
                raise self._silent(motor_id)
            return value

        with self._lock:
            return ask_patiently(ask_once, attempts, self.link)

    def _order_once(self, order: Frame, motor_id: int, extra_wait: float) -> Feedback:
        found = self.feedbacks([order], [motor_id], extra_wait)
        if not found:
            raise self._silent(motor_id)
        return found[motor_id]

    def _exchange(
        self,
        orders: Sequence[Frame],
        find: Callable[[Sequence[Frame]], Result],
        is_enough: Callable[[Result], bool],
        extra_wait: float,
    ) -> Result:
        """Send orders; return what `find` makes of the frames that come, once it is enough or no more can come."""
        with self._lock:
            self.counters.transactions += 1
            self._settle(self.link.send(slcan.encode(orders)))
            begun = self._begun
            heard = self.link.receive(
                _bytes_of(orders), lambda so_far: is_enough(find(slcan.decode(begun + so_far)[0])), extra_wait
            )
            found = find(slcan.decode(begun + heard)[0])
            self._settle(heard)
        return found

    def _settle(self, heard: bytes) -> None:
        """Count what has come: feedbacks that are owed come before those of later orders, or not at all."""
        heard = self._begun + heard
        seen, damaged = slcan.decode(heard)
        self.counters.corrupt += damaged
        self._begun = heard[heard.rfind(slcan.END) + 1 :][-slcan.FRAME_LINE :]
        owed, _ = self._sorted(seen)
        self._at_order |= {one.motor_id: one for one in owed}
        self._owed -= Counter(one.motor_id for one in owed)
        if self.clock.now_s() > self._owed_until:
            self._owed.clear()

    def _feedbacks_of(self, seen: Sequence[Frame]) -> dict[int, Feedback]:
        return {one.motor_id: one for one in self._sorted(seen)[1]}

    def _sorted(self, seen: Sequence[Frame]) -> tuple[list[Feedback], list[Feedback]]:
        """Return the feedbacks that are owed, and the others."""
        left = Counter(self._owed)
        owed: list[Feedback] = []
        own: list[Feedback] = []
        for frame in seen:
            one = frames.feedback(frame, self.ranges)
            if one is None:
                continue
            (owed if left[one.motor_id] > 0 else own).append(one)
            left[one.motor_id] -= 1
        return owed, own

    def _silent(self, motor_id: int) -> NoReplyError:
        return NoReplyError(
            f"port {self.link.path}, motor {motor_id}: expected an answer, found none; check power, both ends' "
            "terminators, and that the motor is set to 1 Mbit/s"
        )


def _bytes_of(orders: Sequence[Frame]) -> int:
    """Return how many bytes some orders, their confirmations and their answers have."""
    return 2 * len(slcan.encode(orders)) + len(orders) * slcan.FRAME_LINE
