# SPDX-License-Identifier: Apache-2.0
"""Whose answer counts on a bus, for how long one is waited for, and what is thrown away before the next question."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.port import BusPort
from softgrip_driver.errors import NoReplyError
from softgrip_testing.driver_fuzz import ScriptedSerial, crc16
from softgrip_time import WallClock

MakeBus = Callable[..., Bus]


def status(servo_id: int, data: bytes) -> bytes:
    """A status packet by the protocol's page: header, ID, length, 0x55, no error, data, CRC."""
    packet = b"\xff\xff\xfd\x00" + bytes((servo_id,)) + (len(data) + 4).to_bytes(2, "little") + b"\x55\x00" + data
    return packet + crc16(packet).to_bytes(2, "little")


@pytest.fixture
def scripted() -> Iterator[MakeBus]:
    """Make a bus whose device answers from a script."""
    serials: list[ScriptedSerial] = []

    def make(*replies: bytes) -> Bus:
        bus = Bus("scripted", 1_000_000, 0.002)
        bus.port.ser = ScriptedSerial(replies)
        bus.port.is_open, bus.port.tx_time_per_byte = True, 0.01
        serials.append(bus.port.ser)
        return bus

    yield make
    for serial in serials:
        serial.close()


def test_a_servo_that_was_not_asked_answers_for_nobody(scripted: MakeBus) -> None:
    replies = scripted(status(9, b"\x09") + status(1, b"\x01") + status(2, b"\x02")).sync_read([1, 2], 64, 1)
    assert {servo_id: reply.data for servo_id, reply in replies.items()} == {1: b"\x01", 2: b"\x02"}


def test_every_lost_reply_is_counted_once_for_all_and_once_for_its_servo(scripted: MakeBus) -> None:
    bus = scripted(status(1, b"\x01"))
    bus.sync_read([1, 2, 3], 64, 1)
    with pytest.raises(NoReplyError):
        bus.read(2, reg.PRESENT_VOLTAGE)
    assert bus.counters.lost == 3
    assert bus.counters.lost_by_id == {2: 2, 3: 1}


def test_before_it_asks_again_it_waits_until_the_line_is_quiet(
    scripted: MakeBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reply that is only late would else answer the next question."""
    bus = scripted(b"", status(1, (50).to_bytes(2, "little")))
    drained: list[tuple[int, float]] = []
    monkeypatch.setattr(bus.port, "drain", lambda quiet, _: drained.append((len(bus.port.ser.sent), quiet)))
    assert bus.read(1, reg.PRESENT_VOLTAGE, attempts=2) == 50
    assert drained == [(1, 0.002)], "between the first question and the second"


class SetClock(WallClock):
    """A clock that stands."""

    time_s = 100.0

    def now_s(self) -> float:
        return self.time_s


def test_a_reply_is_waited_for_as_long_as_its_bytes_take_and_the_margin() -> None:
    """Ten bits a byte at 1 Mbaud: 100 bytes take 1 ms; the margin is 4 ms."""
    clock = SetClock()
    port = BusPort("none", 1_000_000, 0.004, clock)
    port.tx_time_per_byte = 1000.0 * 10 / 1_000_000
    port.allow(100)
    for later, over in ((0.0049, False), (0.0051, True)):
        clock.time_s = 100.0 + later
        assert port.isPacketTimeout() is over
