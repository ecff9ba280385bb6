# SPDX-License-Identifier: Apache-2.0
"""Orders over the real bus loop and its thread: one that was answered as not obeyed never moves anything."""

import math
import threading
import time
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softgrip_driver.errors import DriverError
from softgrip_driver.tendon.backend import Counters, DriveIdentity
from softgrip_driver.tendon.gripper import Block, GripperController, MoveMode, MoveRequest, Policies, StopPolicy
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop

LIMITS = TendonLimits(no_reply=5.0)
DEADLINE_S = 30.0
POLICIES = Policies()


class Device:
    """Closed-form drives whose bus can be held up: what a frozen process or a reopened stage does to the loop."""

    tendons = ("a", "b")

    def __init__(self, finger, reading):
        self.fingers = {name: finger() for name in self.tendons}
        self.powered = dict.fromkeys(self.tendons, False)
        self.counters = Counters()
        self.free = threading.Event()
        self.free.set()
        self.reached_bus = threading.Event()
        self.broken: BaseException | None = None
        self._reading = reading

    def connect(self, **_keep_torque):
        return [DriveIdentity(name, "closed form") for name in self.tendons]

    def is_powered(self, _tendon):
        return False

    def goal_position(self, _tendon):
        return math.nan

    def read(self):
        self.reached_bus.set()
        assert self.free.wait(DEADLINE_S)
        if self.broken is not None:
            raise self.broken
        now = time.monotonic()
        readings = {}
        for name, finger in self.fingers.items():
            finger.time = now
            readings[name] = finger.read(self._reading, powered=self.powered[name])
        return readings

    def write(self, setpoints):
        for name, setpoint in setpoints.items():
            if self.powered[name]:
                self.fingers[name].advance(0.005, setpoint)

    def power(self, tendon, on):
        self.powered[tendon] = on

    def mark_session(self, tendon, mark):
        pass

    def hold_up(self):
        """Let the bus thread stand in its next read."""
        self.free.clear()
        self.reached_bus.clear()
        assert self.reached_bus.wait(DEADLINE_S)


class Cell:
    def __init__(self, finger, reading, policies=POLICIES):
        self.device = Device(finger, reading)
        self.block = None
        self.controller = GripperController(
            dict.fromkeys(Device.tendons, LIMITS), policies, period=0.005, block=lambda: self.block
        )
        self.loop = BusLoop(self.device, self.controller, 200.0)
        self.loop.start()
        assert self.loop.wait_for(lambda seen: all(drive.time > 0.0 for drive in seen.drives), DEADLINE_S)
        for name, finger_ in self.device.fingers.items():
            self.loop.call(lambda c, _, n=name, z=finger_.taut: c.drives[n].set_zero(z, 1))
        self.loop.power(on=True)
        self.cycles(3)

    def request(self, length, **order):
        request = MoveRequest([], MoveMode.LENGTH, [length], LIMITS.speed, LIMITS.tension_soft, **order)
        return lambda controller, now: controller.move(request, now)

    def cycles(self, count):
        """Let the loop run for some cycles."""
        after = self.loop.snapshot.sequence + count
        assert self.loop.wait_for(lambda seen: seen.sequence >= after, DEADLINE_S)

    def lengths(self):
        return [finger.position - finger.taut for finger in self.device.fingers.values()]

    def close(self):
        self.device.free.set()
        self.loop.stop(DEADLINE_S)


@pytest.fixture
def cell(spring_finger, reading):
    made = Cell(spring_finger, reading)
    yield made
    made.close()


def test_an_order_that_timed_out_never_moves_anything(cell):
    before = cell.lengths()
    cell.device.hold_up()
    with pytest.raises(TimeoutError, match="taken back"):
        cell.loop.call(cell.request(0.010), timeout=0.05)
    cell.device.free.set()
    cell.cycles(40)
    assert cell.lengths() == pytest.approx(before, abs=1e-5)


def test_a_flood_of_requests_does_not_keep_the_drives_from_being_read(cell):
    """Each asks for another one, and some for two, so there is never an end of them."""
    served = []

    def flood(_controller, _now):
        served.append(None)
        if not ended.is_set():
            cell.loop.post(flood)
            if len(served) % 64 == 0:
                cell.loop.post(flood)

    ended = threading.Event()
    cell.loop.post(flood)
    try:
        cell.cycles(20)
        assert len(served) > 20, "the requests are served all the same"
    finally:
        ended.set()


def test_a_stop_overtakes_a_flood_of_requests(cell):
    ended = threading.Event()

    def flood(_controller, _now):
        if not ended.is_set():
            cell.loop.post(flood)

    for _ in range(100):
        cell.loop.post(flood)
    try:
        cell.block = Block("stopped", is_stop=True, lets_go=True)
        assert cell.loop.enforce_block() == ""
        assert not any(cell.device.powered.values())
    finally:
        ended.set()


def test_an_order_past_its_deadline_is_refused_on_the_bus_thread(cell):
    before = cell.lengths()
    ticket = cell.loop.call(cell.request(0.010, deadline=time.monotonic() - 0.001))
    assert "deadline" in ticket.refusal
    cell.cycles(20)
    assert cell.lengths() == pytest.approx(before, abs=1e-5)


def test_an_order_that_has_begun_is_answered_with_what_it_did(cell):
    began, goes_on = threading.Event(), threading.Event()

    def slow(_controller, _now):
        began.set()
        assert goes_on.wait(DEADLINE_S)
        return "done"

    answers = []
    asking = threading.Thread(target=lambda: answers.append(cell.loop.call(slow, timeout=0.02)))
    asking.start()
    assert began.wait(DEADLINE_S)
    time_out = threading.Event()
    time_out.wait(0.1)  # the asker's time is over by now; it has to wait for the truth all the same
    goes_on.set()
    asking.join(DEADLINE_S)
    assert answers == ["done"]


def test_an_urgent_order_overtakes_and_stands_although_the_bus_is_busy(cell):
    order = []
    cell.device.hold_up()
    cell.loop.post(lambda _c, _n: order.append("first"))
    cell.block = Block("stop", is_stop=True, lets_go=True)
    with pytest.raises(TimeoutError, match="obeyed first"):
        cell.loop.call(lambda _c, _n: order.append("urgent"), timeout=0.05, urgent=True)
    cell.device.free.set()
    cell.cycles(5)
    assert order == ["urgent", "first"]


def test_whoever_stops_is_answered_although_the_bus_hangs_in_that_very_stop(cell):
    """Whoever serves it still has to tell the other nodes, and to put the stop on disk."""
    began, goes_on = threading.Event(), threading.Event()

    def hangs(_controller, _now):
        began.set()
        assert goes_on.wait(DEADLINE_S)

    raised = []

    def stop():
        with pytest.raises(TimeoutError) as error:
            cell.loop.call(hangs, timeout=0.02, urgent=True)
        raised.append(str(error.value))

    asking = threading.Thread(target=stop)
    asking.start()
    assert began.wait(DEADLINE_S)
    asking.join(DEADLINE_S / 2)
    is_answered = not asking.is_alive()
    goes_on.set()
    asking.join(DEADLINE_S)
    assert is_answered
    assert "has begun" in raised[0]


def test_a_latched_stop_is_enforced_by_the_loop_even_if_nobody_could_tell_it(cell):
    """The state alone is enough: the order to stop may have been lost with whoever gave it."""
    cell.loop.call(cell.request(0.020))
    cell.cycles(5)
    cell.block = Block("stop", is_stop=True, lets_go=True)
    assert cell.loop.wait_for(lambda seen: seen.estop, DEADLINE_S)
    cell.cycles(3)
    assert not any(cell.device.powered.values())
    assert {drive.fault for drive in cell.loop.snapshot.drives} == {"estop"}


def test_a_lock_lets_go_and_refuses_and_the_next_order_after_it_takes_hold_again(cell):
    cell.block = Block("locked by manager", is_stop=False, lets_go=True)
    cell.cycles(5)
    assert not any(cell.device.powered.values())
    assert cell.loop.order(cell.request(0.010), power=True).refusal == "locked by manager"
    for refused in (lambda c, n: c.home(n), lambda c, n: c.release(n)):
        assert cell.loop.order(refused, power=True).refusal == "locked by manager"
    cell.cycles(5)
    assert not any(cell.device.powered.values())
    assert "locked" not in cell.loop.reset(power=False)
    assert not any(cell.device.powered.values())
    cell.block = None
    cell.cycles(5)
    assert not any(cell.device.powered.values()), "unlocking powers nothing"
    ticket = cell.loop.order(cell.request(0.010), power=True)
    assert ticket.refusal == ""
    assert all(cell.device.powered.values())


def test_a_reset_while_deactivated_powers_nothing_even_a_servo_that_is_set_up_again(cell):
    cell.loop.power(on=False)
    cell.loop.call(lambda c, _: c.drives["a"].set_fault("overload", "a test"))
    cell.device.restore = lambda _tendon: iter(())
    cell.loop.reset(power=False)
    cell.cycles(10)
    assert not any(cell.device.powered.values())


@pytest.mark.parametrize("policy", list(StopPolicy))
def test_a_loop_that_breaks_leaves_the_drives_as_the_policy_for_crashes_says(spring_finger, reading, policy):
    cell = Cell(spring_finger, reading, Policies(unclean_end=policy))
    cell.loop.call(cell.request(0.010))
    cell.cycles(3)
    cell.device.broken = ZeroDivisionError("a defect of the loop")
    end = time.monotonic() + DEADLINE_S
    while cell.loop.running:
        assert time.monotonic() < end
        threading.Event().wait(0.01)
    assert isinstance(cell.loop.failure, ZeroDivisionError)
    assert all(cell.device.powered.values()) is (policy is StopPolicy.HOLD)
    assert cell.loop.keeps_hold is (policy is StopPolicy.HOLD)
    assert cell.loop.has_let_go is (policy is StopPolicy.LET_GO)
    with pytest.raises(DriverError, match="does not run"):
        cell.loop.call(cell.request(0.0))


@pytest.mark.parametrize("policy", list(StopPolicy))
def test_an_orderly_end_follows_the_policy_of_the_stop(spring_finger, reading, policy):
    cell = Cell(spring_finger, reading, Policies(estop=policy))
    cell.close()
    assert all(cell.device.powered.values()) is (policy is StopPolicy.HOLD)


def test_an_orderly_end_with_hands_in_the_cell_lets_go_whatever_the_policy(spring_finger, reading):
    cell = Cell(spring_finger, reading, Policies(estop=StopPolicy.HOLD))
    cell.block = Block("locked", is_stop=False, lets_go=True)
    cell.close()
    assert not any(cell.device.powered.values())


def test_pending_orders_are_refused_when_the_loop_ends(cell):
    cell.device.hold_up()
    answers = []

    def ask():
        try:
            cell.loop.call(cell.request(0.010), timeout=DEADLINE_S)
        except DriverError as error:
            answers.append(str(error))

    asking = threading.Thread(target=ask)
    asking.start()
    end = time.monotonic() + DEADLINE_S
    while not cell.loop._requests:
        assert time.monotonic() < end
        threading.Event().wait(0.005)
    cell.loop._stopping = True
    cell.device.broken = ZeroDivisionError("the end")
    cell.device.free.set()
    asking.join(DEADLINE_S)
    assert answers == ["the bus loop has ended"]


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(plan=st.lists(st.tuples(st.booleans(), st.floats(0.002, 0.03), st.floats(0.0, 0.02)), min_size=2, max_size=6))
def test_no_order_that_was_not_obeyed_moves_anything_however_the_bus_stalls(spring_finger, reading, plan):
    """Random stalls around random orders: the hand ends where the last obeyed order sent it, or where it began."""
    cell = Cell(spring_finger, reading)
    try:
        expected, answered = None, []
        for stalls, target, timeout in plan:
            if stalls:
                cell.device.hold_up()
            try:
                ticket = cell.loop.call(cell.request(target), timeout=timeout)
                answered.append(ticket)
                expected = target
            except TimeoutError:
                pass
            cell.device.free.set()
            cell.cycles(2)
        start = cell.lengths()
        if expected is None:
            cell.cycles(20)
            assert cell.lengths() == pytest.approx(start, abs=1e-5)
            return
        assert cell.loop.wait_for(lambda _: answered[-1].result(cell.controller.snapshots())[0] is not None, DEADLINE_S)
        assert cell.lengths() == pytest.approx([expected] * 2, abs=2 * LIMITS.position_tolerance)
    finally:
        cell.close()


def test_a_reading_without_numbers_is_no_answer(cell):
    """NaN from a device: nothing is believed, and after the drive's time it counts as lost."""
    read = cell.device.read
    quick = replace(LIMITS, no_reply=0.05)
    cell.controller.drives["a"].limits = quick

    def without_numbers():
        readings = dict(read())
        readings["a"] = replace(readings["a"], position=math.nan)
        return readings

    cell.device.read = without_numbers
    assert cell.loop.wait_for(lambda seen: seen.drives[0].fault == "no_reply", DEADLINE_S)
    assert math.isfinite(cell.loop.snapshot.drives[0].pulled_length_m)
