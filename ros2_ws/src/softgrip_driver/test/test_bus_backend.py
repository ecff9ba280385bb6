# SPDX-License-Identifier: Apache-2.0
"""What every backend on a bus does with a drive that does not answer, and at both ends of a connection."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import pytest

from softgrip_driver.errors import NoReplyError, PortLostError
from softgrip_driver.tendon.backend import Counters, DriveReading
from softgrip_driver.tendon.bus_backend import BusBackend, BusDevice


@dataclass
class Port:
    """A bus that opens when it is told to be there."""

    counters: Counters = field(default_factory=Counters)
    is_open: bool = False
    is_there: bool = True

    def open(self) -> None:
        if not self.is_there:
            raise PortLostError("gone")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False


@dataclass
class Device(BusDevice):
    name: str
    answer: DriveReading | Exception
    device_id: int = 1

    @property
    def tendon(self) -> str:
        return self.name


class Backend(BusBackend[Device]):
    """The common part alone, with what it asks for written down."""

    def __init__(self, port, devices):
        super().__init__(port, devices)
        self.asked, self.let_go = [], []

    def _ask(self, live):
        self.asked.append(live.tendon)
        if isinstance(live.answer, Exception):
            raise live.answer
        live.met()
        return live.answer

    def _let_go(self, live):
        self.let_go.append(live.tendon)
        if isinstance(live.answer, Exception):
            raise live.answer


def reading():
    return DriveReading(time=1.0, position=0.0, velocity=0.0, tension=0.0, tension_stddev=0.1, pull=0.0)


@pytest.fixture
def silent():
    return Device("index", NoReplyError("nothing"))


@pytest.fixture
def backend(silent):
    return Backend(Port(is_open=True), [silent, Device("thumb", reading())])


def test_three_misses_leave_a_drive_out_of_the_question_to_all(backend, silent):
    for _ in range(2):
        silent.missed(0.0)
    assert [one.tendon for one in backend._present()] == ["index", "thumb"]
    silent.missed(0.0)
    assert [one.tendon for one in backend._present()] == ["thumb"]
    silent.met()
    assert [one.tendon for one in backend._present()] == ["index", "thumb"]


def test_where_nobody_is_left_all_are_asked(backend):
    for device in backend._live.values():
        for _ in range(3):
            device.missed(0.0)
    assert [one.tendon for one in backend._present()] == ["index", "thumb"]


def test_an_absent_drive_is_asked_often_at_first_and_then_seldom(backend, silent):
    for _ in range(3):
        silent.missed(0.0)
    asked_at = []
    for cycle in range(1000):
        before = len(backend.asked)
        backend._probe(cycle * 0.005, {})
        if len(backend.asked) > before:
            asked_at.append(cycle * 0.005)
    waits = [round(b - a, 3) for a, b in itertools.pairwise(asked_at)]
    assert asked_at[0] == pytest.approx(0.01)
    assert waits[0] == pytest.approx(0.02)
    assert waits[-1] == pytest.approx(0.25)
    assert waits == sorted(waits)


def test_one_that_answers_again_is_read(backend, silent):
    for _ in range(3):
        silent.missed(0.0)
    silent.answer, found = reading(), {}
    backend._probe(0.02, found)
    assert list(found) == ["index"]
    assert not silent.absent


def test_a_port_that_goes_away_meanwhile_is_told(backend, silent):
    for _ in range(3):
        silent.missed(0.0)
    silent.answer = PortLostError("gone")
    with pytest.raises(PortLostError):
        backend._probe(0.02, {})


def test_disconnecting_lets_go_of_all_that_hear_it(backend):
    backend.disconnect()
    assert backend.let_go == ["index", "thumb"]
    assert not backend._port.is_open
    backend.let_go.clear()
    backend._port.is_open = True
    backend.disconnect(keep_torque=True)
    assert backend.let_go == []
    assert not backend._port.is_open


def test_a_port_is_taken_up_again_once_it_is_there(backend, silent):
    for _ in range(3):
        silent.missed(0.0)
    backend._port.is_open, backend._port.is_there = False, False
    assert not backend.reconnect()
    backend._port.is_there = True
    assert backend.reconnect()
    assert backend.counters.reopened == 1
    assert not silent.absent
