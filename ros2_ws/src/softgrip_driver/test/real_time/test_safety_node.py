# SPDX-License-Identifier: Apache-2.0
"""tendon_driver as a process: the stop that stays, the lock around hands, one owner; by the truth of the servos."""

import signal
import threading
import time

import pytest
from builtin_interfaces.msg import Duration
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_driver.tendon.gripper import MoveMode
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import LeaseHeartbeat, SafetyState, TendonOwners, TendonStatus, TendonStatusArray
from softgrip_interfaces.srv import AcquireLease, AcquireLock, ReleaseLease, ReleaseLock
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.node_processes import node_processes, peer_node
from softgrip_testing.waiting import TEST_TIMEOUT_S

pytestmark = [pytest.mark.ros, pytest.mark.slow]
Goal, Result = MoveTendon.Goal, MoveTendon.Result
#: [s] a driver's process is frozen for, longer than `softgrip_driver.tendon.safety.MAX_DEAF_S`
STANDSTILL_S = 2.5


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())


@pytest.fixture
def start(domain, wire, tmp_path):
    given = (
        "no_reply_s:=0.5", "bus_watchdog_s:=1.0", "reply_margin_s:=0.02", f"port:={wire.bus.port.port_name}",
        f"safety_file:={tmp_path / 'safety.yaml'}", f"zero_file:={tmp_path / 'zeros.yaml'}",
    )  # fmt: skip
    with node_processes("softgrip_driver.nodes.tendon_driver", given) as started:
        yield started


@pytest.fixture
def peer(domain):
    with peer_node("safety_test") as one:
        yield one


@pytest.fixture
def driver(start, peer, wire):
    return Driver(start, peer, wire)


class Driver:
    """A driver's process and what a client sees of it."""

    def __init__(self, start, peer, wire):
        self._start, self.peer, self.wire = start, peer, wire
        self.process = None
        self.statuses = peer.hear(TendonStatusArray, "tendon/status", SENSOR)
        self.safety = peer.hear(SafetyState, "safety/state", LATCHED)
        self.owners = peer.hear(TendonOwners, "tendon/owners", LATCHED)
        self.client = ActionClient(peer.node, MoveTendon, "tendon/move")

    def start(self, *parameters):
        self.statuses.clear()
        self.safety.clear()
        self.process = self._start(*parameters)
        self.peer.spin_until(lambda: self.statuses and self.safety)
        return self

    def restart(self, *parameters):
        """Start another process after this one; returns when it is active."""
        return self.start(*parameters)

    def home(self):
        homed = self.peer.trigger("tendon/home")
        assert homed.success, homed.message
        return self

    def move(self, target, mode=Goal.LENGTH, tension_limit=20.0, **fields):
        assert self.client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
        goal = Goal(mode=mode, targets=[target], speed=0.02, tension_limit=tension_limit, **fields)
        handle = self.peer.wait(self.client.send_goal_async(goal))
        return self.peer.wait(handle.get_result_async()).result

    def torque(self):
        return [servo.registers.get("torque_enable") for servo in self.wire.plant.servos]

    def goals(self):
        return [servo.registers.get("goal_position") for servo in self.wire.plant.servos]

    def wait_for_states(self, *states):
        self.peer.spin_until(lambda: {one.state for one in self.statuses[-1].tendons} == set(states))

    def lock(self, owner="test", reason="hands in the palm", token=""):
        return self.peer.call(AcquireLock, "tendon/lock", owner=owner, reason=reason, token=token)

    def lease(self, owner="test", duration=5.0, **fields):
        return self.peer.call(AcquireLease, "tendon/lease", owner=owner, duration=duration, **fields)

    def change_state(self, transition):
        request = {"transition": Transition(id=transition)}
        assert self.peer.call(ChangeState, "tendon_driver/change_state", **request).success


def end_by_kill(driver):
    driver.process.kill()
    driver.process.wait(TEST_TIMEOUT_S)
    driver.restart()


def end_by_sigterm(driver):
    driver.process.send_signal(signal.SIGTERM)
    assert driver.process.wait(TEST_TIMEOUT_S) == 0
    driver.restart()


def cycle_the_lifecycle(driver):
    for transition in (
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
    ):
        driver.change_state(transition)


@pytest.mark.parametrize("ends", [end_by_kill, end_by_sigterm, cycle_the_lifecycle])
def test_a_stop_outlives_every_end_of_the_driver_with_torque_off(driver, ends):
    driver.start().home()
    assert driver.peer.trigger("estop").success
    assert driver.torque() == [0, 0, 0]
    ends(driver)
    driver.wait_for_states(TendonStatus.STOPPED)
    assert driver.statuses[-1].estop
    assert driver.safety[-1].estop
    assert driver.torque() == [0, 0, 0]
    refused = driver.move(0.01)
    assert refused.outcome == Result.REFUSED
    assert "estop_reset" in refused.reason
    assert not driver.peer.trigger("tendon/home").success
    assert driver.peer.trigger("estop_reset").success
    driver.wait_for_states(TendonStatus.HOLDING)
    assert not driver.safety[-1].estop


def test_a_stop_is_latched_before_the_drives_are_connected(driver):
    driver.process = driver._start("autostart:=false")
    driver.peer.spin_until(lambda: driver.safety)
    assert driver.peer.trigger("estop").success
    driver.change_state(Transition.TRANSITION_CONFIGURE)
    driver.change_state(Transition.TRANSITION_ACTIVATE)
    driver.peer.spin_until(lambda: driver.statuses and driver.statuses[-1].estop)
    assert driver.torque() == [0, 0, 0]


def test_a_reset_of_a_deactivated_driver_powers_nothing(driver):
    driver.start()
    driver.wait_for_states(TendonStatus.HOLDING)
    driver.peer.trigger("estop")
    driver.change_state(Transition.TRANSITION_DEACTIVATE)
    assert driver.peer.trigger("estop_reset").success
    driver.wait_for_states(TendonStatus.IDENTIFIED)
    assert driver.torque() == [0, 0, 0]


def test_a_driver_that_stood_still_obeys_nothing_of_that_time_and_is_stopped_until_the_reset(driver):
    """Whoever asked meanwhile has given up; and a stop that was asked for may be among what was lost."""
    driver.start().home()
    driver.wait_for_states(TendonStatus.HOLDING)
    clients = [driver.peer.node.create_client(Trigger, name) for name in ("tendon/home", "estop_reset")]
    assert all(client.wait_for_service(timeout_sec=TEST_TIMEOUT_S) for client in clients)
    goals = driver.goals()
    driver.process.send_signal(signal.SIGSTOP)
    asked = [client.call_async(Trigger.Request()) for client in clients]
    time.sleep(STANDSTILL_S)
    driver.process.send_signal(signal.SIGCONT)
    driver.peer.spin_until(lambda: driver.safety[-1].estop)
    assert "stood still for" in driver.safety[-1].estop_reason
    heard = len(driver.statuses)
    driver.peer.spin_until(lambda: len(driver.statuses) > heard + 10)
    assert driver.safety[-1].estop, "a reset of that time does not end it"
    assert not any(future.done() and future.result().success for future in asked)
    assert driver.goals() == pytest.approx(goals, abs=65), "homing winds out by millimetres, which are 65 pulses each"
    driver.peer.spin_until(lambda: driver.peer.trigger("estop_reset").success)
    driver.wait_for_states(TendonStatus.HOLDING)
    assert driver.move(0.004).outcome == Result.REACHED


def test_deactivation_leaves_torque_off_and_ends_a_running_move(driver):
    driver.start().home()
    assert driver.client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
    goal = Goal(mode=Goal.LENGTH, targets=[0.012], speed=0.002, tension_limit=20.0)
    running = driver.peer.wait(driver.client.send_goal_async(goal)).get_result_async()
    driver.wait_for_states(TendonStatus.MOVING)
    driver.change_state(Transition.TRANSITION_DEACTIVATE)
    assert driver.torque() == [0, 0, 0]
    result = driver.peer.wait(running).result
    assert result.outcome == Result.CANCELLED
    assert "torque was switched off" in result.reason


def test_a_hold_outlives_a_killed_driver_and_nothing_moves_until_the_reset(driver):
    driver.start().home()
    assert driver.move(8.0, mode=Goal.TENSION).outcome == Result.REACHED
    # A servo counts as holding a moment after it came to rest; until then its watchdog would stop it.
    driver.peer.spin_until(lambda: all(s.registers.get("bus_watchdog") == 0 for s in driver.wire.plant.servos))
    held = driver.wire.plant.bank.tension_n.copy()
    lowest = held.copy()
    watching, watched = threading.Event(), threading.Event()

    def watch():
        while not watching.wait(0.005):
            lowest[:] = [min(a, b) for a, b in zip(lowest, driver.wire.plant.bank.tension_n, strict=True)]
        watched.set()

    threading.Thread(target=watch, daemon=True).start()
    driver.process.kill()
    driver.process.wait(TEST_TIMEOUT_S)
    driver.restart()
    driver.wait_for_states(TendonStatus.STOPPED)
    assert driver.torque() == [1, 1, 1]
    assert "ended without letting go" in driver.safety[-1].estop_reason
    goals = driver.goals()
    assert driver.move(0.0).outcome == Result.REFUSED
    assert driver.goals() == pytest.approx(goals, abs=12)
    assert driver.peer.trigger("estop_reset").success
    driver.wait_for_states(TendonStatus.HOLDING)
    watching.set()
    assert watched.wait(TEST_TIMEOUT_S)
    assert (lowest > 0.8 * held).all(), (lowest, held)
    assert all(one.homed for one in driver.statuses[-1].tendons)
    assert driver.move(0.004).outcome == Result.REACHED


def test_a_killed_driver_lets_go_where_the_policy_says_so(driver):
    driver.start("unclean_end_policy:=let_go").home()
    assert driver.move(8.0, mode=Goal.TENSION).outcome == Result.REACHED
    driver.process.kill()
    driver.process.wait(TEST_TIMEOUT_S)
    driver.restart("unclean_end_policy:=let_go")
    driver.wait_for_states(TendonStatus.STOPPED)
    assert driver.torque() == [0, 0, 0]


def test_a_stop_policy_of_holding_is_respected_at_an_orderly_end(driver):
    driver.start("estop_policy:=hold").home()
    assert driver.move(8.0, mode=Goal.TENSION).outcome == Result.REACHED
    driver.process.send_signal(signal.SIGTERM)
    assert driver.process.wait(TEST_TIMEOUT_S) == 0
    assert driver.torque() == [1, 1, 1]


@pytest.mark.parametrize("ends", [None, end_by_kill, end_by_sigterm])
def test_hands_in_the_cell_torque_is_off_and_every_order_refused_until_the_owner_unlocks(driver, ends):
    driver.start().home()
    locked = driver.lock()
    assert locked.success, locked.message
    if ends is not None:
        ends(driver)
    assert driver.torque() == [0, 0, 0]
    assert driver.safety[-1].locked
    assert driver.move(0.01).outcome == Result.REFUSED
    for name in ("tendon/home", "tendon/release"):
        answer = driver.peer.trigger(name)
        assert not answer.success
        assert "locked by test" in answer.message
    stream = driver.peer.node.create_publisher(JointTrajectory, "tendon/trajectory", RELIABLE)
    driver.peer.spin_until(lambda: stream.get_subscription_count() > 0)
    point = JointTrajectoryPoint(positions=[0.01], time_from_start=Duration(nanosec=100_000_000))
    stream.publish(JointTrajectory(joint_names=["index"], points=[point]))
    driver.peer.trigger("estop")
    driver.peer.trigger("estop_reset")
    assert not driver.lock("stranger", "none").success
    assert not driver.peer.call(ReleaseLock, "tendon/unlock", token="guess").success
    assert driver.torque() == [0, 0, 0]
    assert driver.peer.call(ReleaseLock, "tendon/unlock", token=locked.token).success
    driver.peer.spin_until(lambda: not driver.safety[-1].locked)
    assert driver.torque() == [0, 0, 0], "unlocking powers nothing"
    driver.home()
    assert driver.torque() == [1, 1, 1]


def test_an_owners_orders_are_obeyed_and_a_strangers_are_not(driver):
    driver.start().home()
    lease = driver.lease("manager")
    assert lease.success, lease.message
    driver.peer.spin_until(lambda: driver.owners and {o.owner for o in driver.owners[-1].owners} == {"manager"})
    refused = driver.move(0.01)
    assert refused.outcome == Result.REFUSED
    assert "owned by manager" in refused.reason
    assert driver.move(0.01, lease=lease.token).outcome == Result.REACHED
    assert not driver.lease("stranger").success
    assert driver.peer.call(ReleaseLease, "tendon/lease_release", token=lease.token).success
    assert driver.move(0.0).outcome == Result.REACHED


def test_an_owner_that_falls_silent_stops_what_it_moves(driver):
    driver.start().home()
    assert driver.client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
    beat = driver.peer.node.create_publisher(LeaseHeartbeat, "tendon/heartbeat", RELIABLE)
    driver.peer.spin_until(lambda: beat.get_subscription_count() > 0)
    lease = driver.lease("manager", duration=2.0)
    timer = driver.peer.node.create_timer(0.2, lambda: beat.publish(LeaseHeartbeat(token=lease.token)))
    goal = Goal(mode=Goal.LENGTH, targets=[0.015], speed=0.001, tension_limit=20.0, lease=lease.token)
    running = driver.peer.wait(driver.client.send_goal_async(goal)).get_result_async()
    driver.wait_for_states(TendonStatus.MOVING)
    timer.cancel()
    result = driver.peer.wait(running).result
    assert result.outcome == Result.FAULT
    assert "no heartbeat of manager" in result.reason
    assert max(result.pulled_lengths) < 0.012
    driver.wait_for_states(TendonStatus.STOPPED)


def test_a_stream_that_ends_in_the_middle_stops(driver):
    """One trajectory of twenty seconds, and nobody who sends it is alive afterwards."""
    driver.start().home()
    states = driver.peer.hear(JointState, "tendon/state", SENSOR)
    stream = driver.peer.node.create_publisher(JointTrajectory, "tendon/trajectory", RELIABLE)
    driver.peer.spin_until(lambda: stream.get_subscription_count() > 0)
    point = JointTrajectoryPoint(positions=[0.030], time_from_start=Duration(sec=20))
    stream.publish(JointTrajectory(joint_names=["index"], points=[point]))
    driver.peer.spin_until(lambda: any(one.fault == "owner_lost" for one in driver.statuses[-1].tendons))
    driver.peer.spin_until(lambda: states)
    assert states[-1].position[0] < 0.005


def test_an_order_without_limits_is_refused(driver):
    driver.start().home()
    assert "tension limit above 0" in driver.move(0.01, tension_limit=0.0).reason
    assert "LENGTH" in driver.move(0.01, mode=Goal.MODE_UNSET).reason
    assert int(MoveMode.LENGTH) == Goal.LENGTH
    assert int(MoveMode.TENSION) == Goal.TENSION
