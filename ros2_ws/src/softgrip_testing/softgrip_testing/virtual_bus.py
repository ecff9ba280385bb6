# SPDX-License-Identifier: Apache-2.0
"""The driver's bus, wired to emulated servos without a port, in a time of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import takewhile

from softgrip_driver.dynamixel.bus import Bus, BusReply
from softgrip_driver.dynamixel.registers import ControlItem
from softgrip_driver.errors import NoReplyError
from softgrip_emulator.dynamixel.packets import Instruction, Packet
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_time import Clock


class VirtualBus(Bus):
    """Transactions take no time; a silenced servo answers nobody, and nobody behind it answers a group read.

    Args:
        servos: on the bus.
        now_s: the time of their world [s].
        clock: of the driver; the computer's where none is given.
    """

    def __init__(self, servos: Iterable[EmulatedServo], now_s: Callable[[], float], clock: Clock | None = None) -> None:
        super().__init__("virtual", 1_000_000, clock=clock)
        self._servos = {servo.device_id: servo for servo in servos}
        self._now_s = now_s

    def open(self) -> None:
        """Nothing to open."""

    def close(self) -> None:
        """Nothing to close."""

    @property
    def is_open(self) -> bool:
        """Always there."""
        return True

    def turnaround(self, servo_id: int) -> float:
        """No time."""
        del servo_id
        return 0.0

    def _exchange(self, servo_id: int, instruction: int, parameters: bytes, size: int, attempts: int) -> BusReply:
        del size, attempts
        now_s = self._now_s()
        for each in self._servos.values():
            each.heard(now_s)
        if self._servos[servo_id].silenced:
            raise NoReplyError(f"servo {servo_id} is silenced")
        answer = self._servos[servo_id].execute(Packet(servo_id, Instruction(instruction), parameters), now_s)
        return BusReply(servo_id, bool(answer.error & 0x80), answer.error & 0x7F, answer.parameters)

    def sync_write(self, item: ControlItem, values: Mapping[int, int]) -> None:
        """Write at once."""
        for servo_id, value in values.items():
            self._servos[servo_id].write_for_host(item.address, item.encode(value), self._now_s())

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, BusReply]:
        """Read at once."""
        now_s, replies = self._now_s(), {}
        for servo_id in takewhile(lambda one: not self._servos[one].silenced, servo_ids):
            self._servos[servo_id].heard(now_s)
            answer = self._servos[servo_id].read_for_host(address, size, now_s)
            replies[servo_id] = BusReply(servo_id, bool(answer.error & 0x80), answer.error & 0x7F, answer.parameters)
        return replies

    def fast_sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, BusReply]:
        """Read as `sync_read` does, or nothing where one is silenced."""
        replies = self.sync_read(servo_ids, address, size)
        return replies if len(replies) == len(servo_ids) else {}

    def push_through(self, seconds: float) -> None:
        """Nothing lies in it."""
