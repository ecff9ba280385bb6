# SPDX-License-Identifier: Apache-2.0
"""gripper_command before scripted tendons: flags, refusals, owners, the path of ros2_control; all in one executor."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import GripperCommand, ParallelGripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from softgrip_cell.nodes.gripper_command import GripperCommandNode
from softgrip_description import shipped_hand
from softgrip_description.opening import gripper_opening
from softgrip_interfaces.action import Grasp, MoveTendon
from softgrip_interfaces.msg import CellState, LeaseHeartbeat, MountedFinger, SafetyState, TendonOwner, TendonOwners
from softgrip_interfaces.srv import AcquireLease, ReleaseLease
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.gripper_goals import TEN_GOALS, GoalCase, MockSetting, outcome_of

pytestmark = pytest.mark.ros
SLOTS = ("index", "middle", "thumb")
PERIOD_S = 0.01
DEADLINE_S = 30.0


class ScriptedTendons(Node):
    """Tendons that go where they are told at once pace, and stop where something is in the way; one owner at a time."""

    def __init__(self) -> None:
        super().__init__("scripted_tendons")
        self.pulled_length_m = 0.0
        self.blocked_at_m = 1.0
        self.speed_m_s = 0.0
        self.target_m: float | None = None
        self.orders: list[Any] = []
        self.owner, self.requested_by, self.token = "", "", ""
        self.outcome = MoveTendon.Result.REACHED
        self.quiet = False
        self.beats: list[str] = []
        self.grasped: list[str] = []
        self.grasp_outcome = Grasp.Result.GRIPPED
        self._move: tuple[Any, Future] | None = None
        self._state = self.create_publisher(JointState, "tendon/state", SENSOR)
        self._owners = self.create_publisher(TendonOwners, "tendon/owners", LATCHED)
        self._safety = self.create_publisher(SafetyState, "safety/state", LATCHED)
        self.create_subscription(LeaseHeartbeat, "tendon/heartbeat", lambda m: self.beats.append(m.token), RELIABLE)
        self.create_service(AcquireLease, "tendon/lease", self._on_lease)
        self.create_service(ReleaseLease, "tendon/lease_release", self._on_release)
        for kind, name, run in ((MoveTendon, "tendon/move", self._run), (Grasp, "cell/grasp", self._grasp)):
            ActionServer(self, kind, name, execute_callback=run, cancel_callback=lambda _handle: CancelResponse.ACCEPT)
        self.create_timer(PERIOD_S, self._tick)
        self.publish_safety()
        self.publish_owners()

    def publish_safety(self, **fields: Any) -> None:
        self._safety.publish(SafetyState(**fields))

    def publish_owners(self) -> None:
        entries = [TendonOwner(tendon=name, owner=self.owner, requested_by=self.requested_by) for name in SLOTS]
        self._owners.publish(TendonOwners(owners=entries))

    def _on_lease(self, request: Any, response: Any) -> Any:
        if self.owner:
            self.requested_by = request.owner if request.hand_over else ""
            response.message = f"the tendons are owned by '{self.owner}'"
        else:
            self.owner, self.token, self.requested_by = request.owner, f"token-{time.monotonic_ns()}", ""
            response.success, response.token, response.duration = True, self.token, request.duration
        self.publish_owners()
        return response

    def _on_release(self, request: Any, response: Any) -> Any:
        response.success = bool(self.token) and request.token == self.token
        if response.success:
            self.owner = self.token = ""
        self.publish_owners()
        return response

    async def _grasp(self, handle: Any) -> Grasp.Result:
        self.grasped.append(handle.request.product)
        handle.succeed()
        return Grasp.Result(outcome=self.grasp_outcome, reason="scripted")

    async def _run(self, handle: Any) -> MoveTendon.Result:
        goal = handle.request
        self.orders.append(goal)
        if goal.lease != self.token:
            handle.abort()
            return MoveTendon.Result(outcome=MoveTendon.Result.REFUSED, reason="not the owner's token")
        if self.outcome != MoveTendon.Result.REACHED:
            handle.abort()
            return MoveTendon.Result(outcome=self.outcome, reason="scripted")
        if self._move is not None:
            self._move[1].set_result(MoveTendon.Result.CANCELLED)
        done = Future()
        self._move, self.target_m, self.speed_m_s = (handle, done), goal.targets[0], goal.speed
        outcome = await done
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return MoveTendon.Result(outcome=outcome)

    def _tick(self) -> None:
        before = self.pulled_length_m
        if self.target_m is not None:
            step = self.speed_m_s * PERIOD_S
            self.pulled_length_m += min(max(self.target_m - self.pulled_length_m, -step), step)
            self.pulled_length_m = min(self.pulled_length_m, self.blocked_at_m)
        if self._move is not None:
            handle, done = self._move
            if handle.is_cancel_requested:
                self._end(done, MoveTendon.Result.CANCELLED)
                self.target_m = None
            elif self.pulled_length_m == self.target_m:
                self._end(done, MoveTendon.Result.REACHED)
            elif self.pulled_length_m == self.blocked_at_m:
                self._end(done, MoveTendon.Result.TENSION_LIMIT)
        if self.quiet:
            return
        velocity = (self.pulled_length_m - before) / PERIOD_S
        message = JointState(
            name=list(SLOTS), position=[self.pulled_length_m] * 3, velocity=[velocity] * 3, effort=[3.0, 4.5, 2.0]
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._state.publish(message)

    def _end(self, done: Future, outcome: int) -> None:
        self._move = None
        done.set_result(outcome)


class Bench:
    """The node under test, scripted tendons and a client, spun by whoever waits."""

    def __init__(self, **parameters: Any) -> None:
        given = {"stall_timeout_s": 0.3, **parameters}
        arguments = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        rclpy.init(args=["--ros-args", *arguments])
        self.tendons, self.client = ScriptedTendons(), Node("client")
        self.gripper = GripperCommandNode()
        self.executor = SingleThreadedExecutor()
        for node in (self.tendons, self.client, self.gripper):
            self.executor.add_node(node)
        self.states: list[JointState] = []
        self.health: list[DiagnosticArray] = []
        self.client.create_subscription(JointState, "gripper/joint_states", self.states.append, SENSOR)
        self.client.create_subscription(DiagnosticArray, "/diagnostics", self.health.append, RELIABLE)
        self.commands = self.client.create_publisher(JointState, "gripper/joint_commands", RELIABLE)
        self.cell = self.client.create_publisher(CellState, "cell/state", LATCHED)
        self.clients = {
            GripperCommand: ActionClient(self.client, GripperCommand, "gripper/command"),
            ParallelGripperCommand: ActionClient(self.client, ParallelGripperCommand, "gripper/gripper_cmd"),
        }
        self.until(lambda: self.states and all(client.server_is_ready() for client in self.clients.values()))

    def until(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < end, "not in time"
            self.executor.spin_once(timeout_sec=0.02)

    def wait(self, future: Future) -> Any:
        self.until(future.done)
        return future.result()

    def send(self, position_m: float, effort_n: float = 0.0, feedback: list[Any] | None = None) -> Any:
        goal = GripperCommand.Goal()
        goal.command.position, goal.command.max_effort = position_m, effort_n
        heard = feedback if feedback is not None else []
        return self.wait(self.clients[GripperCommand].send_goal_async(goal, feedback_callback=heard.append))

    def send_parallel(self, position: list[float], **fields: Any) -> Any:
        goal = ParallelGripperCommand.Goal(command=JointState(position=position, **fields))
        return self.wait(self.clients[ParallelGripperCommand].send_goal_async(goal))

    def result(self, handle: Any) -> tuple[int, Any]:
        assert handle.accepted
        ended = self.wait(handle.get_result_async())
        return ended.status, ended.result

    def said(self, words: str) -> bool:
        return any(words in status.message for array in self.health for status in array.status)

    def close(self) -> None:
        self.executor.shutdown()
        for node in (self.gripper, self.client, self.tendons):
            node.destroy_node()  # DDS would give the next test what this one's latched topics said
        rclpy.try_shutdown()


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    os.environ["ROS_DOMAIN_ID"] = own_domain()
    made: list[Bench] = []

    def start(**parameters: Any) -> Bench:
        made.append(Bench(**parameters))
        return made[-1]

    yield start
    for bench in made:
        bench.close()


@pytest.fixture(scope="module")
def opening():
    return gripper_opening(shipped_hand(), load_directory(shipped_directory()), dict.fromkeys(SLOTS, "power"))


def flags(result: Any) -> tuple[bool, bool]:
    return result.reached_goal, result.stalled


def test_a_free_hand_reaches_its_goals_by_either_action(make: Callable[..., Bench], opening: Any) -> None:
    bench = make()
    feedback: list[Any] = []
    status, result = bench.result(bench.send(0.060, 9.0, feedback))
    assert (status, *flags(result)) == (GoalStatus.STATUS_SUCCEEDED, True, False)
    assert result.position == pytest.approx(0.060, abs=0.002)
    assert result.effort == pytest.approx(4.5)
    assert feedback
    assert bench.tendons.orders[-1].tension_limit == 9.0
    assert list(bench.tendons.orders[-1].tendons) == list(SLOTS)
    assert bench.tendons.orders[-1].targets[0] == pytest.approx(opening.pulled_length_m(0.060))
    assert bench.tendons.orders[-1].mode == MoveTendon.Goal.LENGTH
    status, result = bench.result(bench.send_parallel([opening.max_m], effort=[11.0], velocity=[0.05]))
    assert (status, *flags(result)) == (GoalStatus.STATUS_SUCCEEDED, True, False)
    assert list(result.state.name) == ["gripper_opening"]
    assert result.state.position[0] == pytest.approx(opening.max_m, abs=0.002)
    assert bench.tendons.orders[-1].tension_limit == 11.0
    assert bench.tendons.orders[-1].speed == pytest.approx(opening.tendon_speed_m_s(0.05))


@pytest.mark.parametrize("setting", list(MockSetting))
def test_goals_end_as_those_of_parallel_gripper_controller(
    make: Callable[..., Bench], opening: Any, setting: MockSetting
) -> None:
    """The ten goals that the real controller ended so on mock hardware, too: versions are in gripper_goals."""
    bench = make(allow_stalling=str(setting is not MockSetting.STRICT).lower())
    bench.tendons.pulled_length_m = opening.pulled_length_m(0.1)
    if setting is not MockSetting.FREE:
        bench.tendons.blocked_at_m = bench.tendons.pulled_length_m

    def standing_m() -> float:
        bench.states.clear()
        bench.until(lambda: len(bench.states) > 1)  # the first may be older than the last goal's end
        return float(bench.states[-1].position[0])

    def disagreement(case: GoalCase) -> str:
        at_m = standing_m()
        return case.disagreement(outcome_of(case, bench.clients[ParallelGripperCommand], at_m, bench.until), at_m)

    cases = [case for case in TEN_GOALS if case.setting is setting]
    assert {case.name: disagreement(case) for case in cases} == {case.name: "" for case in cases}


@pytest.mark.parametrize(("allowed", "status"), [("true", "STATUS_SUCCEEDED"), ("false", "STATUS_ABORTED")])
def test_a_product_in_the_way_stalls_the_goal(
    make: Callable[..., Bench], opening: Any, allowed: str, status: str
) -> None:
    bench = make(allow_stalling=allowed)
    bench.tendons.blocked_at_m = opening.pulled_length_m(0.070)
    found, result = bench.result(bench.send(0.040))
    assert (found, *flags(result)) == (getattr(GoalStatus, status), False, True)
    assert result.position == pytest.approx(0.070, abs=1e-4)


@pytest.mark.parametrize(
    ("fields", "tension_limit_n"),
    [({}, 20.0), ({"velocity": [0.05], "effort": [8.0]}, 8.0)],
    ids=["no limits in its controllers.yaml", "max_effort and max_velocity"],
)
def test_moveit_closes_on_a_product_by_parallel_gripper_command(
    make: Callable[..., Bench], opening: Any, fields: dict[str, Any], tension_limit_n: float
) -> None:
    """ParallelGripperCommandControllerHandle of moveit2 fills a goal in like this: a position under the joint's name,
    velocity and effort only where they are configured. MoveIt goes by the status alone.
    """
    bench = make()
    bench.tendons.blocked_at_m = opening.pulled_length_m(0.070)
    handle = bench.send_parallel([0.040], name=["gripper_opening"], **fields)
    assert bench.result(handle)[0] == GoalStatus.STATUS_SUCCEEDED
    assert bench.tendons.orders[-1].tension_limit == tension_limit_n


@pytest.mark.parametrize(("effort_n", "tension_limit_n"), [(0.0, 20.0), (12.0, 12.0)])
def test_moveit_and_nexus_close_by_gripper_command(
    make: Callable[..., Bench], opening: Any, effort_n: float, tension_limit_n: float
) -> None:
    """moveit2's GripperControllerHandle sends a max_effort of 0 unless one is configured; NEXUS' GripperControl
    (nexus_capabilities, gripper_control.cpp) sends both ports of its behaviour tree.
    """
    bench = make()
    status, result = bench.result(bench.send(0.050, effort_n))
    assert (status, *flags(result)) == (GoalStatus.STATUS_SUCCEEDED, True, False)
    assert bench.tendons.orders[-1].tension_limit == tension_limit_n


def test_a_goal_that_is_there_already_is_reached(make: Callable[..., Bench], opening: Any) -> None:
    bench = make()
    assert flags(bench.result(bench.send(opening.max_m))[1]) == (True, False)


def test_goals_out_of_range_are_rejected_and_the_reason_said(make: Callable[..., Bench]) -> None:
    bench = make()
    assert not bench.send(0.5).accepted
    bench.until(lambda: bench.said("position: expected"))
    assert not bench.send(0.06, effort_n=1000.0).accepted
    bench.until(lambda: bench.said("max effort: expected"))
    assert not bench.send(float("nan")).accepted
    assert not bench.send_parallel([]).accepted
    assert not bench.send_parallel([0.06, 0.06]).accepted
    bench.until(lambda: bench.said("expected 1 value"))
    assert bench.tendons.orders == []


def test_a_cancelled_goal_stops_the_fingers_and_says_nothing_else(make: Callable[..., Bench], opening: Any) -> None:
    bench = make(max_velocity_m_s=0.01)
    handle = bench.send(0.040)
    bench.until(lambda: bench.tendons.pulled_length_m > 0.0005)
    bench.wait(handle.cancel_goal_async())
    status, result = bench.result(handle)
    assert (status, *flags(result), result.position) == (GoalStatus.STATUS_CANCELED, False, False, 0.0)
    bench.until(lambda: bench.tendons.target_m is None)
    assert bench.tendons.pulled_length_m < opening.pulled_length_m(0.040)


def test_a_newer_goal_of_the_other_action_takes_over(make: Callable[..., Bench], opening: Any) -> None:
    bench = make(max_velocity_m_s=0.05)
    first = bench.send(0.040)
    bench.until(lambda: bench.tendons.pulled_length_m > 0.0005)
    second = bench.send_parallel([opening.max_m])
    status, result = bench.result(first)
    assert (status, *flags(result)) == (GoalStatus.STATUS_ABORTED, False, False)
    assert flags(bench.result(second)[1]) == (True, False)


def test_an_emergency_stop_ends_the_goal_and_refuses_the_next(make: Callable[..., Bench]) -> None:
    bench = make(max_velocity_m_s=0.01)
    handle = bench.send(0.040)
    bench.until(lambda: bench.tendons.pulled_length_m > 0.0005)
    bench.tendons.publish_safety(estop=True, estop_reason="scripted")
    status, result = bench.result(handle)
    assert (status, *flags(result)) == (GoalStatus.STATUS_ABORTED, False, False)
    assert not bench.send(0.060).accepted
    bench.until(lambda: bench.said("the emergency stop is latched: scripted"))
    bench.until(lambda: not bench.tendons.owner)


def test_hands_in_the_cell_refuse_every_goal(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.tendons.publish_safety(locked=True, lock_owner="somebody", lock_reason="cleaning")
    bench.until(lambda: not bench.send(0.060).accepted)
    bench.until(lambda: bench.said("locked by 'somebody': cleaning"))


def test_silent_tendons_end_the_goal_and_refuse_the_next(make: Callable[..., Bench]) -> None:
    bench = make(max_velocity_m_s=0.01, silence_s=0.4)
    handle = bench.send(0.040)
    bench.until(lambda: bench.tendons.pulled_length_m > 0.0005)
    bench.tendons.quiet = True
    assert bench.result(handle)[0] == GoalStatus.STATUS_ABORTED
    assert not bench.send(0.060).accepted


def test_a_driver_that_refuses_ends_the_goal_without_flags(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.tendons.outcome = MoveTendon.Result.FAULT
    status, result = bench.result(bench.send(0.060))
    assert (status, *flags(result)) == (GoalStatus.STATUS_ABORTED, False, False)


def test_an_owner_is_asked_to_hand_over_and_waited_for(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.tendons.owner, bench.tendons.token = "grasp_mix_manager", "theirs"
    bench.tendons.publish_owners()
    handle = bench.send(0.060)
    bench.until(lambda: bench.tendons.requested_by == "gripper_command")
    assert bench.tendons.orders == []
    bench.tendons.owner = bench.tendons.token = ""
    bench.tendons.publish_owners()
    assert flags(bench.result(handle)[1]) == (True, False)
    assert bench.tendons.orders[-1].lease == bench.tendons.token


def test_an_owner_that_does_not_hand_over_ends_the_goal(make: Callable[..., Bench]) -> None:
    bench = make(lease_s=0.5)
    bench.tendons.owner, bench.tendons.token = "grasp_mix_manager", "theirs"
    bench.tendons.publish_owners()
    assert bench.result(bench.send(0.060))[0] == GoalStatus.STATUS_ABORTED
    assert bench.tendons.orders == []


def test_a_closed_hand_keeps_its_lease_and_an_open_one_gives_it_back(make: Callable[..., Bench], opening: Any) -> None:
    bench = make(lease_s=0.5)
    bench.result(bench.send(0.050))
    beats = len(bench.tendons.beats)
    bench.until(lambda: len(bench.tendons.beats) > beats + 8)
    assert bench.tendons.owner == "gripper_command"
    bench.result(bench.send(opening.max_m))
    bench.until(lambda: not bench.tendons.owner)


def test_a_closed_hand_is_handed_over_to_who_asks(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.result(bench.send(0.050))
    bench.tendons.requested_by = "grasp_mix_manager"
    bench.tendons.publish_owners()
    bench.until(lambda: not bench.tendons.owner)


@pytest.mark.parametrize(
    ("outcome", "reached", "stalled"),
    [(Grasp.Result.GRIPPED, False, True), (Grasp.Result.EMPTY, True, False), (Grasp.Result.SLIPPED, False, False)],
)
def test_a_closing_goal_grasps_the_selected_product(
    make: Callable[..., Bench], outcome: int, reached: bool, stalled: bool
) -> None:
    bench = make(close_by="grasp")
    bench.tendons.grasp_outcome = outcome
    bench.cell.publish(CellState(mode=CellState.IDLE, product="egg"))
    bench.until(lambda: bench.gripper._cell is not None)
    status, result = bench.result(bench.send(0.040))
    expected = GoalStatus.STATUS_SUCCEEDED if reached or stalled else GoalStatus.STATUS_ABORTED
    assert (status, *flags(result)) == (expected, reached, stalled)
    assert bench.tendons.grasped == ["egg"]
    assert bench.tendons.orders == []


def test_without_a_selected_product_the_fingers_are_just_moved(make: Callable[..., Bench]) -> None:
    bench = make(close_by="grasp")
    assert flags(bench.result(bench.send(0.060))[1]) == (True, False)
    assert bench.tendons.grasped == []


def stream(bench: Bench, position_m: float, effort_n: float = 20.0) -> None:
    """Say a command as ros2_control does, once a look."""
    bench.commands.publish(JointState(name=["gripper_opening"], position=[position_m], effort=[effort_n]))


def heard(bench: Bench, position_m: float) -> None:
    """Repeat a command until it must have arrived: as long as ten states took."""
    count = len(bench.states) + 10

    def arrived() -> bool:
        stream(bench, position_m)
        return len(bench.states) > count

    bench.until(arrived)


def test_a_stream_of_joint_commands_moves_the_hand_and_its_state_comes_back(
    make: Callable[..., Bench], opening: Any
) -> None:
    bench = make()
    nan = float("nan")
    heard(bench, nan)  # of a command interface that nobody has set
    heard(bench, bench.states[-1].position[0])  # of a controller that has just become active
    assert bench.tendons.orders == []
    command = JointState(name=["other", "gripper_opening"], position=[0.0, 0.060], effort=[nan, nan])

    def arrived() -> bool:
        bench.commands.publish(command)
        return abs(bench.states[-1].position[0] - 0.060) < 0.0005

    bench.until(arrived)
    assert len(bench.tendons.orders) == 1
    assert bench.tendons.orders[0].tension_limit == 20.0
    state = bench.states[-1]
    assert list(state.name) == ["gripper_opening"]
    assert state.effort[0] == pytest.approx(4.5)


@pytest.mark.parametrize("profile", ["power", "pinch", "hook"])
def test_every_set_follows_the_commands_of_ros2_control_over_its_own_range(
    make: Callable[..., Bench], profile: str
) -> None:
    """parallel_gripper_controller restarted after a swap: where the hand stands, then goals within the new range."""
    profiles = load_directory(shipped_directory())
    slots = [slot for slot in SLOTS if slot in profiles[profile].slots]
    opening = gripper_opening(shipped_hand(), profiles, dict.fromkeys(slots, profile))
    bench = make()
    mounted = [MountedFinger(finger=slot, serial="x", profile=profile, state=MountedFinger.VERIFIED) for slot in slots]
    bench.cell.publish(CellState(mode=CellState.IDLE, mounted=mounted))
    bench.until(lambda: bench.states[-1].position[0] == pytest.approx(opening.max_m, abs=1e-6))
    heard(bench, bench.states[-1].position[0])
    assert bench.tendons.orders == []
    for share in (0.5, 0.05, 0.95):
        position_m = opening.min_m + share * (opening.max_m - opening.min_m)
        bench.until(lambda at=position_m: not stream(bench, at) and abs(bench.states[-1].position[0] - at) < 0.0005)
        order = bench.tendons.orders[-1]
        assert list(order.tendons) == slots
        assert order.targets[0] == pytest.approx(opening.pulled_length_m(position_m))
    orders = len(bench.tendons.orders)
    bench.until(lambda: not stream(bench, opening.max_m + 0.01) and bench.said("position: expected"))
    assert len(bench.tendons.orders) == orders


def test_a_controller_that_becomes_active_takes_the_hand_from_nobody(make: Callable[..., Bench], opening: Any) -> None:
    """It commands where the gripper stands; the manager holds a product there."""
    bench = make()
    heard(bench, bench.states[-1].position[0])
    bench.until(lambda: not stream(bench, 0.060) and abs(bench.states[-1].position[0] - 0.060) < 0.0005)
    bench.tendons.owner, bench.tendons.token, bench.tendons.pulled_length_m = "grasp_mix_manager", "theirs", 0.006
    bench.tendons.target_m = None
    bench.gripper._lease.release()
    bench.tendons.publish_owners()
    bench.until(lambda: not bench.gripper._lease.token and bench.states[-1].position[0] > 0.061)
    held_m, orders = bench.states[-1].position[0], len(bench.tendons.orders)
    heard(bench, held_m)  # ros2_control was started again
    assert (bench.tendons.requested_by, len(bench.tendons.orders)) == ("", orders)
    bench.tendons.pulled_length_m = 0.0  # the manager opens; the command stays
    heard(bench, held_m)
    assert (bench.tendons.requested_by, len(bench.tendons.orders)) == ("", orders)
    bench.until(lambda: not stream(bench, 0.050) and bench.tendons.requested_by == "gripper_command")


def test_what_was_commanded_before_the_node_was_there_moves_nothing(make: Callable[..., Bench]) -> None:
    """gripper_command is started again after a crash, and the controller still commands its last goal."""
    bench = make()
    heard(bench, 0.060)
    bench.until(lambda: bench.said("the first one heard asks for 0.0600 m"))
    assert bench.tendons.orders == []
    bench.until(lambda: not stream(bench, 0.050) and abs(bench.states[-1].position[0] - 0.050) < 0.0005)


def test_what_is_commanded_during_an_action_goal_is_not_done_after_it(make: Callable[..., Bench], opening: Any) -> None:
    bench = make(max_velocity_m_s=0.02)
    heard(bench, bench.states[-1].position[0])
    handle = bench.send(0.090)
    bench.until(lambda: bench.tendons.pulled_length_m > 0.0005)
    heard(bench, 0.050)
    assert flags(bench.result(handle)[1]) == (True, False)
    heard(bench, 0.050)
    bench.until(lambda: bench.said("an action goal goes first"))
    assert [order.targets[0] for order in bench.tendons.orders] == [pytest.approx(opening.pulled_length_m(0.090))]


def test_a_joint_command_out_of_range_is_refused_and_said(make: Callable[..., Bench]) -> None:
    bench = make()
    heard(bench, bench.states[-1].position[0])
    bench.until(lambda: not stream(bench, 0.5) and bench.said("position: expected"))
    assert bench.tendons.orders == []


def test_the_range_follows_the_mounted_fingers(make: Callable[..., Bench]) -> None:
    bench = make()
    assert not bench.send(0.115).accepted
    mounted = [MountedFinger(finger=slot, serial="x", profile="hook", state=MountedFinger.VERIFIED) for slot in SLOTS]
    bench.cell.publish(CellState(mode=CellState.IDLE, mounted=mounted))
    bench.until(lambda: bench.send(0.115).accepted)


def test_a_hand_without_a_thumb_is_named(make: Callable[..., Bench]) -> None:
    bench = make()
    mounted = [MountedFinger(finger="index", serial="x", profile="power", state=MountedFinger.VERIFIED)]
    bench.cell.publish(CellState(mode=CellState.IDLE, mounted=mounted))
    bench.until(lambda: bench.said("expected a finger on each side"))
    assert not bench.send(0.060).accepted


def test_parameters_of_another_number_of_profiles_are_refused() -> None:
    os.environ["ROS_DOMAIN_ID"] = own_domain()
    rclpy.init(args=["--ros-args", "-p", "profiles:=[power]"])
    try:
        with pytest.raises(Exception, match="expected one for each"):
            GripperCommandNode()
    finally:
        rclpy.try_shutdown()
