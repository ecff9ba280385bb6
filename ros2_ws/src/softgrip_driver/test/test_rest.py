# SPDX-License-Identifier: Apache-2.0
"""The bus loop goes slower while nothing happens, and is back within a period when something does."""

import select
import threading
from collections import deque
from dataclasses import replace
from itertools import pairwise

import pytest

from softgrip_driver.tendon.backend import Counters, DriveReading
from softgrip_driver.tendon.gripper import Block, GripperController, MoveMode, MoveRequest, Policies, StopPolicy
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.rest import REST_AFTER_S, rest_stride
from softgrip_time import WallClock

RATE, STRIDE = 100.0, 4
PERIOD_S, REST_PERIOD_S = 0.01, 0.04


class BoundedClock(WallClock):
    """A time that passes only while the loop waits, up to where the test lets it."""

    def __init__(self):
        self._now_s, self._end_s = 0.0, 0.0
        self._changed = threading.Condition()
        self._stands = False

    def now_s(self):
        return self._now_s

    def wait_readable(self, files, until_s):
        while not (ready := select.select(files, (), (), 0.0)[0]):
            with self._changed:
                if until_s <= self._end_s:
                    self._now_s = max(self._now_s, until_s)
                    return []
                self._now_s, self._stands = max(self._now_s, self._end_s), True
                self._changed.notify_all()
                self._changed.wait(0.01)
        return ready

    def run_to(self, end_s):
        """Let the time pass; return when the loop waits for a later one."""
        with self._changed:
            self._end_s, self._stands = end_s, False
            self._changed.notify_all()
            assert self._changed.wait_for(lambda: self._stands, 120.0)


class Device:
    """One drive that answers with what it was told to."""

    tendons = ("pull",)

    def __init__(self, clock):
        self.clock = clock
        self.counters = Counters()
        self.reading = DriveReading(0.0, 0.01, 0.0, 0.0, 0.1, 0.0, current=0.0, temperature=30.0, voltage=5.0)
        self.answers = True
        self.powered = False
        self.switched = []
        #: (time [s], change of the reading or of the device)
        self.script = deque()

    def read(self):
        while self.script and self.script[0][0] <= self.clock.now_s():
            self.script.popleft()[1]()
        if not self.answers:
            return {}
        return {"pull": replace(self.reading, time=self.clock.now_s(), powered=self.powered)}

    def report(self, **values):
        self.reading = replace(self.reading, **values)

    def write(self, setpoints):
        pass

    def power(self, _tendon, on):
        self.powered = on
        self.switched.append((self.clock.now_s(), on))

    def mark_session(self, tendon, mark):
        pass


class Cell:
    def __init__(self, stride=STRIDE):
        self.clock = BoundedClock()
        self.device = Device(self.clock)
        self.block = None
        policies = Policies(estop=StopPolicy.LET_GO)
        self.controller = GripperController({"pull": TendonLimits()}, policies, block=lambda: self.block)
        self.loop = BusLoop(self.device, self.controller, RATE, 4096, self.clock, stride)
        self.loop.start()

    def seen(self, begin_s=0.0):
        """Return the intervals [s] between the cycles from a time [s] on."""
        times = [one.time for one in self.loop.since(0, 0.0) if one.time >= begin_s - 1e-9]
        return [after - before for before, after in pairwise(times)]

    def times(self):
        return [one.time for one in self.loop.since(0, 0.0)]


@pytest.fixture
def cell():
    one = Cell()
    yield one
    one.loop.stop()


def at_rest(cell):
    """Hold a slack tendon until the loop rests; return the time [s]."""
    cell.clock.run_to(0.1)
    cell.loop.power(on=True)
    cell.clock.run_to(4.0)
    assert cell.loop.snapshot.is_resting
    return cell.clock.now_s()


@pytest.mark.parametrize(
    ("loop_rate", "rest_rate", "watchdog_s", "stride"),
    [
        (100.0, 20.0, 0.08, 4),  # 20 Hz would leave one cycle and a half for the watchdog
        (100.0, 20.0, 0.0, 5),
        (100.0, 10.0, 1.0, 10),
        (200.0, 20.0, 0.08, 8),
        (100.0, 0.0, 0.08, 1),
        (10.0, 20.0, 0.08, 1),
        (30.0, 20.0, 0.1, 1),
    ],
)
def test_two_cycles_at_rest_fall_into_the_silence_after_which_a_device_stops(loop_rate, rest_rate, watchdog_s, stride):
    assert rest_stride(loop_rate, rest_rate, watchdog_s) == stride
    if watchdog_s and stride > 1:
        assert 2 * stride / loop_rate <= watchdog_s + 1e-12


def test_a_slack_hold_is_looked_at_less_often_after_a_while(cell):
    at_rest(cell)
    began = 0.1 + REST_AFTER_S
    assert cell.seen()[: round(began / PERIOD_S) - 1] == pytest.approx([PERIOD_S] * (round(began / PERIOD_S) - 1))
    assert cell.seen(began + 0.1) == pytest.approx([REST_PERIOD_S] * len(cell.seen(began + 0.1)))
    assert len(cell.seen(began + 0.1)) > 30
    assert (cell.loop.snapshot.rate, cell.loop.snapshot.asked_rate) == pytest.approx((25.0, 25.0))
    assert cell.loop.snapshot.missed_cycles == 0


def test_an_order_at_rest_is_served_at_once_and_the_next_cycle_comes_within_a_period(cell):
    asked = at_rest(cell)
    before = len(cell.times())
    cell.loop.call(lambda controller, _: controller.drives["pull"].set_zero(0.01, 1))
    assert len(cell.times()) == before  # it did not wait for a cycle
    cell.clock.run_to(asked + REST_AFTER_S - 0.1)
    assert cell.times()[before] - asked <= PERIOD_S + 1e-9
    assert cell.seen(cell.times()[before]) == pytest.approx([PERIOD_S] * len(cell.seen(cell.times()[before])))
    assert len(cell.seen(asked)) > 150
    cell.clock.run_to(asked + REST_AFTER_S + 1.0)
    assert cell.loop.snapshot.is_resting


def test_a_request_that_changes_nothing_yet_ends_the_rest(cell):
    """What it asks for may show in a later cycle: until then the loop is quick."""
    asked = at_rest(cell)
    before = len(cell.times())
    cell.loop.call(lambda _controller, _now: None)
    cell.clock.run_to(asked + REST_AFTER_S - 0.1)
    assert cell.seen(cell.times()[before]) == pytest.approx([PERIOD_S] * len(cell.seen(cell.times()[before])))
    assert len(cell.seen(asked)) > 150


def test_a_stop_at_rest_switches_off_without_waiting_for_a_cycle(cell):
    asked = at_rest(cell)
    cell.block = Block("stopped by a test", is_stop=True, lets_go=True)
    assert cell.loop.enforce_block() == ""
    assert cell.device.switched[-1] == (asked, False)
    cell.clock.run_to(asked + 5.0)
    assert not cell.loop.snapshot.is_resting  # a cell that was stopped is watched closely


@pytest.mark.parametrize("lets_go", [True, False])
def test_a_locked_cell_is_watched_closely(cell, lets_go):
    asked = at_rest(cell)
    cell.block = Block("hands are inside", is_stop=False, lets_go=lets_go)
    cell.loop.enforce_block()
    cell.clock.run_to(asked + 3.0)
    assert cell.seen(asked + 0.1) == pytest.approx([PERIOD_S] * len(cell.seen(asked + 0.1)))


def moved(device):
    device.report(position=device.reading.position + 2e-4)


def pulled(device):
    device.report(tension=2.0, pull=2.0)


def silent(device):
    device.answers = False


def faulty(device):
    device.report(faults=("overheated",))


def crept(device):
    """Little by little, each step less than what counts as a change."""
    device.report(position=device.reading.position + 1e-4)


@pytest.mark.parametrize("change", [moved, silent, faulty])
def test_the_cycle_that_shows_a_change_is_the_last_slow_one(cell, change):
    begin = at_rest(cell)
    cell.device.script.append((begin + 0.005, lambda: change(cell.device)))
    cell.clock.run_to(begin + 0.5)
    intervals = cell.seen(begin)
    times = [time for time in cell.times() if time >= begin]
    shown = next(number for number, time in enumerate(times) if time >= begin + 0.005)
    assert times[shown] - (begin + 0.005) <= REST_PERIOD_S + 1e-9
    assert intervals[shown:] == pytest.approx([PERIOD_S] * len(intervals[shown:]))
    assert len(intervals[shown:]) > 40


def test_a_pull_from_outside_is_seen_by_the_second_cycle(cell):
    """The tension is the median of three samples, so that it takes two to show one."""
    begin = at_rest(cell)
    cell.device.script.append((begin + 0.005, lambda: pulled(cell.device)))
    cell.clock.run_to(begin + 0.5)
    late = [time for time in cell.times() if time >= begin + 0.005 + 2.0 * REST_PERIOD_S]
    assert [after - before for before, after in pairwise(late)] == pytest.approx([PERIOD_S] * (len(late) - 1))


def test_a_tendon_that_creeps_is_looked_at_closely(cell):
    begin = at_rest(cell)
    cell.device.script.extend((begin + 0.5 * step, lambda: crept(cell.device)) for step in range(1, 20))
    cell.clock.run_to(begin + 9.0)
    assert cell.seen(begin + 1.1) == pytest.approx([PERIOD_S] * len(cell.seen(begin + 1.1)))


def owned(cell):
    cell.loop.call(lambda controller, now: controller.ownership.acquire("a person", [], 20.0, now))


def taut(cell):
    cell.device.report(tension=2.0, pull=2.0)


def moving(cell):
    cell.loop.call(lambda controller, _: controller.drives["pull"].set_zero(0.0, 1))
    request = MoveRequest([], MoveMode.LENGTH, [0.02], 0.001, 10.0)
    assert not cell.loop.call(lambda controller, now: controller.move(request, now)).refusal


@pytest.mark.parametrize("work", [owned, taut, moving])
def test_a_tendon_that_is_owned_pulled_or_moved_is_looked_at_in_every_period(cell, work):
    cell.clock.run_to(0.1)
    cell.loop.power(on=True)
    work(cell)
    cell.clock.run_to(5.0)
    assert cell.seen() == pytest.approx([PERIOD_S] * len(cell.seen()))


def test_drives_that_have_let_go_rest_too(cell):
    cell.clock.run_to(REST_AFTER_S + 0.5)
    assert cell.loop.snapshot.is_resting


def test_a_loop_that_is_not_to_rest_never_does():
    cell = Cell(stride=1)
    cell.clock.run_to(6.0)
    assert cell.seen() == pytest.approx([PERIOD_S] * len(cell.seen()))
    cell.loop.stop()
