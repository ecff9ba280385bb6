# SPDX-License-Identifier: Apache-2.0
"""The bag's time, on a wall clock of the test's own."""

import threading

import pytest

from softgrip_bag.nodes.commands import play
from softgrip_bag.nodes.commands.play import Pace


class WallClock:
    """Time that passes only while somebody sleeps."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def wall_clock(monkeypatch):
    made = WallClock()
    monkeypatch.setattr(play, "time", made)
    return made


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_a_position_is_reached_at_its_time(wall_clock, rate):
    reported = []
    playing = Pace(rate, reported.append, 0.01)
    for position in (0.0, 0.2, 1.0):
        playing.wait_for(position)
        assert wall_clock.now == pytest.approx(100.0 + position / rate, abs=1e-6)
        assert reported[-1] == position
    nanoseconds = [round(1e9 * position) for position in reported]
    assert nanoseconds == sorted(nanoseconds)
    # the time is told all the while, not only with messages
    assert len(reported) > 0.9 * 1.0 / rate / 0.01


def test_as_fast_as_possible_takes_no_time(wall_clock):
    playing = Pace(0.0, lambda _: None, 0.01)
    for position in (0.0, 5.0, 500.0):
        playing.wait_for(position)
    assert wall_clock.now == 100.0


def test_a_pause_stops_the_bags_time_and_takes_nothing_from_it(wall_clock):
    playing = Pace(2.0, lambda _: None, 0.01)
    playing.wait_for(1.0)
    playing.toggle()
    assert playing.paused
    wall_clock.now += 60.0
    playing.toggle()
    playing.wait_for(3.0)
    assert wall_clock.now == pytest.approx(100.0 + 0.5 + 60.0 + 1.0, abs=1e-6)


def test_it_stands_until_it_is_let_go():
    playing = Pace(0.0, lambda _: None, 0.001, paused=True)
    arrived = threading.Event()
    worker = threading.Thread(target=lambda: (playing.wait_for(1.0), arrived.set()), daemon=True)
    worker.start()
    assert not arrived.wait(0.05)
    playing.toggle()
    assert arrived.wait(10.0)
