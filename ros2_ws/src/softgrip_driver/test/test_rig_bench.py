# SPDX-License-Identifier: Apache-2.0
"""Stage and gauge are one at a time's: a measurement waits for a look, and another measurement is refused."""

import threading

import pytest

from softgrip_driver.rig.bench import Bench, BusyError


class Slow:
    """A device that answers when it is let."""

    def __init__(self) -> None:
        self.asked, self.let = threading.Event(), threading.Event()

    def open(self) -> str:
        return "a device"

    def close(self) -> None:
        self.closed = True

    def travel(self) -> float:
        self.asked.set()
        assert self.let.wait(10.0)
        return 0.0

    def tension(self) -> float:
        return 1.0


@pytest.fixture
def device():
    return Slow()


def test_a_measurement_waits_for_a_look_of_the_idle_rig(device):
    bench = Bench(device, device)
    looking = threading.Thread(target=bench.read_idle, args=(0.0,))
    looking.start()
    assert device.asked.wait(10.0)
    measured = threading.Event()

    def measure():
        with bench.measuring():
            measured.set()

    measuring = threading.Thread(target=measure)
    measuring.start()
    assert not measured.wait(0.1)
    device.let.set()
    assert measured.wait(10.0)
    for thread in (looking, measuring):
        thread.join(10.0)


def test_a_measurement_takes_up_again_what_went_away(device):
    device.let.set()
    bench = Bench(device, device)
    bench.open()
    opened = []
    device.open = lambda: opened.append("again")
    with bench.measuring():
        assert not opened
    bench._disconnect()
    with bench.measuring():
        assert opened == ["again", "again"]


def test_two_measurements_at_once_are_refused_and_nobody_looks_meanwhile(device):
    bench = Bench(device, device)
    with bench.measuring():
        with pytest.raises(BusyError, match="cancel"), bench.measuring():
            pass
        assert bench.read_idle(0.0) is None
    device.let.set()
    sample = bench.read_idle(2.0)
    assert sample is not None
    assert (sample.time, sample.tension) == (2.0, 1.0)
