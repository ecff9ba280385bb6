# SPDX-License-Identifier: Apache-2.0
"""tendon_driver as a process on emulated servos: its topics, services, action, and every way out."""

import signal
import threading

import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import MultiThreadedExecutor
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_driver.errors import DriverError
from softgrip_driver.nodes.tendon_driver import TendonDriver
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import TendonStatus, TendonStatusArray
from softgrip_nodekit import RELIABLE, SENSOR
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.node_processes import node_processes, peer_node
from softgrip_testing.waiting import TEST_TIMEOUT_S

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())


@pytest.fixture
def start(domain, tmp_path):
    patient = ("no_reply_s:=0.5", "bus_watchdog_s:=1.0", "reply_margin_s:=0.02")
    kept = (f"safety_file:={tmp_path / 'safety.yaml'}", f"zero_file:={tmp_path / 'zeros.yaml'}")
    with node_processes("softgrip_driver.nodes.tendon_driver", (*patient, *kept)) as started:
        yield started


@pytest.fixture
def peer(domain):
    with peer_node("driver_test") as one:
        yield one


def length_goal(*targets, speed=0.02, **fields):
    return MoveTendon.Goal(
        mode=MoveTendon.Goal.LENGTH, targets=list(targets), speed=speed, tension_limit=20.0, **fields
    )


def move(peer, client, goal):
    handle = peer.wait(client.send_goal_async(goal))
    return peer.wait(handle.get_result_async())


def torque(wire):
    return [servo.registers.get("torque_enable") for servo in wire.plant.servos]


def test_a_session_from_homing_to_ctrl_c(wire, start, peer, tmp_path):
    process = start(f"port:={wire.bus.port.port_name}")
    states = peer.hear(JointState, "tendon/state", SENSOR)
    statuses = peer.hear(TendonStatusArray, "tendon/status", SENSOR)
    health = peer.hear(DiagnosticArray, "/diagnostics", RELIABLE)
    client = ActionClient(peer.node, MoveTendon, "tendon/move")
    assert client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)

    refused = move(peer, client, length_goal(0.01))
    assert refused.status == GoalStatus.STATUS_ABORTED
    assert refused.result.outcome == MoveTendon.Result.REFUSED
    assert "call tendon/home" in refused.result.reason

    homed = peer.trigger("tendon/home")
    assert homed.success, homed.message
    assert (tmp_path / "zeros.yaml").exists()

    reached = move(peer, client, length_goal(0.008, tendons=["index"]))
    assert reached.result.outcome == MoveTendon.Result.REACHED, reached.result.reason
    assert list(reached.result.tendons) == ["index"]
    assert reached.result.pulled_lengths[0] == pytest.approx(0.008, abs=1.5e-3)

    point = JointTrajectoryPoint(positions=[0.004], time_from_start=Duration(sec=0, nanosec=100_000_000))
    streamed = peer.node.create_publisher(JointTrajectory, "tendon/trajectory", RELIABLE)
    peer.spin_until(lambda: streamed.get_subscription_count() > 0)

    def followed():
        streamed.publish(JointTrajectory(joint_names=["index"], points=[point]))
        return states and abs(states[-1].position[0] - 0.004) < 1.5e-3

    peer.spin_until(followed)

    stopped = peer.trigger("estop")
    assert stopped.success
    peer.spin_until(lambda: statuses and statuses[-1].estop)
    assert all(servo.registers.get("torque_enable") == 0 for servo in wire.plant.servos)
    assert {status.fault for status in statuses[-1].tendons} == {"estop"}
    assert peer.trigger("estop_reset").success
    peer.spin_until(lambda: all(status.state == TendonStatus.HOLDING for status in statuses[-1].tendons))
    assert peer.trigger("tendon/release").success

    peer.spin_until(lambda: bool(health))
    names = {status.name for array in health for status in array.status}
    assert {f"tendon_driver: {part}" for part in ("bus", "index", "middle", "thumb")} <= names
    assert list(states[-1].name) == ["index", "middle", "thumb"]
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=TEST_TIMEOUT_S) == 0
    assert all(servo.registers.get("torque_enable") == 0 for servo in wire.plant.servos)


def test_a_move_can_be_cancelled_and_holds(wire, start, peer):
    start(f"port:={wire.bus.port.port_name}", "home_on_activate:=true")
    client = ActionClient(peer.node, MoveTendon, "tendon/move")
    assert client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
    statuses, feedback = peer.hear(TendonStatusArray, "tendon/status", SENSOR), []
    peer.spin_until(lambda: statuses and all(status.homed for status in statuses[-1].tendons))
    goal = length_goal(0.012, speed=0.003)
    handle = peer.wait(client.send_goal_async(goal, feedback_callback=feedback.append))
    peer.spin_until(lambda: len(feedback) > 3)
    peer.wait(handle.cancel_goal_async())
    result = peer.wait(handle.get_result_async())
    assert result.status == GoalStatus.STATUS_CANCELED
    assert result.result.outcome == MoveTendon.Result.CANCELLED
    assert max(result.result.pulled_lengths) < 0.011


@pytest.mark.parametrize("ends", [signal.SIGTERM, signal.SIGHUP])
def test_a_kill_and_a_closed_terminal_let_go(wire, start, peer, ends):
    before = signal.signal(ends, signal.SIG_DFL)  # tests under nohup have it ignored, and so would what they start
    process = start(f"port:={wire.bus.port.port_name}")
    statuses = peer.hear(TendonStatusArray, "tendon/status", SENSOR)
    peer.spin_until(lambda: statuses and all(one.state == TendonStatus.HOLDING for one in statuses[-1].tendons))
    signal.signal(ends, before)
    assert all(servo.registers.get("torque_enable") == 1 for servo in wire.plant.servos)
    process.send_signal(ends)
    assert process.wait(timeout=TEST_TIMEOUT_S) == 0
    assert all(servo.registers.get("torque_enable") == 0 for servo in wire.plant.servos)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ("port:=/nowhere", "expected a free serial port"),
        ("baud:=57600", "at 1000000 baud"),
        ("servo_ids:=[1,2,9]", "found ID 1, 2, 3 instead"),
        ("servo_models:=[XC330-T288] loop_rate:=200.0 speed_m_s:=0.03", "found XL330-M288 (1200)"),
        ("servo_models:=[XM430-W350]", "expected homing_tension_n of at least 5 N"),
        ("servo_ids:=[1,1,2]", "expected each ID once"),
        ("write_eeprom:=false", "is 250, needs 0"),
        ("loop_rate:=9000.0", "loop_rate"),
    ],
)
def test_what_keeps_it_from_starting_is_said(wire, start, parameters, message):
    wire.plant.servos[0].registers.put("return_delay_time", 250)
    given = parameters.split()
    if not parameters.startswith("port"):
        given.insert(0, f"port:={wire.bus.port.port_name}")
    process = start(*given)
    _, errors = process.communicate(timeout=TEST_TIMEOUT_S)
    assert process.returncode == 2
    assert message in errors


class RecordingLoop:
    """Stands in for the bus: records what is asked of it."""

    snapshot, failure = None, None

    def __init__(self):
        self.asked = []

    def order(self, request, *, power):
        assert power
        request(self, 0.0)
        raise DriverError("noted")

    def move(self, request, _now):
        self.asked.append(tuple(request.targets))


def test_of_two_moves_in_a_row_the_second_is_the_last_to_begin(peer, monkeypatch, tmp_path):
    """Whatever thread comes first to wait for its end: the first move's is held up here."""
    at_once = ServerGoalHandle.execute
    held_up = []

    def execute(handle, *arguments):
        if not held_up:
            held_up.append(threading.Timer(0.2, at_once, (handle, *arguments)))
            held_up[0].start()
        else:
            at_once(handle, *arguments)

    monkeypatch.setattr(ServerGoalHandle, "execute", execute)
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    driver = TendonDriver()
    driver._loop, driver._active = RecordingLoop(), True
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(driver)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    try:
        client = ActionClient(peer.node, MoveTendon, "tendon/move")
        assert client.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
        goals = [length_goal(target) for target in (0.0, 0.012)]
        handles = [peer.wait(sent) for sent in [client.send_goal_async(goal) for goal in goals]]
        results = [peer.wait(handle.get_result_async()).result for handle in handles]
        assert driver._loop.asked == [(0.0,), (0.012,)]
        assert [result.reason for result in results] == ["noted", "noted"]
    finally:
        driver._loop = None
        executor.shutdown()
        spinning.join(5.0)
        driver.close()
        driver.destroy_node()
