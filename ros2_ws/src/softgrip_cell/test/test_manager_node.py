# SPDX-License-Identifier: Apache-2.0
"""The manager as a process of its own, against a scripted driver and predictor on the bench of conftest.py."""

from __future__ import annotations

import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import Point
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from softgrip_cell.errors import RefusedError
from softgrip_cell.grasp.values import Close, Open, Phase, Press, Step, Stop
from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController
from softgrip_interfaces.action import Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    FingerState,
    FingerStates,
    FrictionModel,
    MountedFinger,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_interfaces.srv import ConfirmStep
from softgrip_nodekit import LATCHED, SENSOR, to_time_message

pytestmark = pytest.mark.ros

SLOTS = ("index", "middle", "thumb")


class ScriptedDriver(Node):
    """Driver, predictor and friction rig in one node; the bench says what the tendons feel."""

    def __init__(self, bench: Any) -> None:
        super().__init__("scripted_driver")
        self.bench = bench
        self.profile = "power"
        self.fault = ""
        self.estop = False
        self.released = 0
        self.blocked: set[str] = set()
        self._gates: list[Future] = []
        self._goals: list[tuple[Any, tuple[float, ...], Future]] = []
        self._state = self.create_publisher(JointState, "tendon/state", SENSOR)
        self._status = self.create_publisher(TendonStatusArray, "tendon/status", SENSOR)
        self._predicted = self.create_publisher(FingerStates, "finger/predicted", SENSOR)
        self._friction = self.create_publisher(FrictionModel, "friction/active", LATCHED)
        self.create_service(Trigger, "tendon/release", self._on_release)
        self.create_service(Trigger, "tendon/home", self._on_home)
        ActionServer(
            self,
            MoveTendon,
            "tendon/move",
            execute_callback=self._move,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.cell: CellState | None = None
        self.create_timer(0.005, self._tick)
        self.publish_friction()

    def publish_friction(self, *, age_s: float = 60.0, model: str = "synthetic", high_n: float = 9.81) -> None:
        stamp = to_time_message(self.get_clock().now().nanoseconds - int(age_s * 1e9))
        message = FrictionModel(id=model, tension_range=[2.0, high_n])
        message.header.stamp = stamp
        self._friction.publish(message)

    def _on_cell(self, message: CellState) -> None:
        self.cell = message
        profiles = {mounted.profile for mounted in message.mounted if mounted.profile}
        if len(profiles) == 1:
            self.profile = profiles.pop()

    def unblock(self) -> None:
        """Answer again; whoever asked meanwhile is told no."""
        self.blocked = set()
        for gate in self._gates:
            gate.set_result(None)
        self._gates.clear()

    async def _blocked(self) -> None:
        gate = Future()
        self._gates.append(gate)
        await gate

    async def _on_release(self, _request: Any, response: Any) -> Any:
        if "release" in self.blocked:
            await self._blocked()
            return response
        self.released += 1
        self.bench.obey(Step(Phase.APPROACH, (Open(),)))
        response.success = True
        return response

    async def _on_home(self, _request: Any, response: Any) -> Any:
        if "home" in self.blocked:
            await self._blocked()
            return response
        response.success = True
        return response

    async def _move(self, handle: Any) -> MoveTendon.Result:
        goal = handle.request
        tendons = list(goal.tendons) or list(SLOTS)
        slots = tuple(SLOTS.index(name) for name in tendons)
        targets = tuple(goal.targets)
        if goal.mode == goal.TENSION:
            self.bench.obey(Step(Phase.HOLD, (Press(slots, targets),)))
            handle.succeed()
            return MoveTendon.Result(outcome=MoveTendon.Result.REACHED)
        if max(targets) == 0.0:
            self.bench.obey(Step(Phase.APPROACH, (Open(),)))
            handle.succeed()
            return MoveTendon.Result(outcome=MoveTendon.Result.REACHED)
        self.bench.obey(Step(Phase.CLOSE, (Close(slots, targets, goal.speed, goal.tension_limit),)))
        done = Future()
        self._goals.append((handle, tuple(zip(slots, targets, strict=True)), done))
        outcome = await done
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return MoveTendon.Result(outcome=outcome)

    def _tick(self) -> None:
        self.bench.now_ns = self.get_clock().now().nanoseconds - 5_000_000
        pair = self.bench.pair()
        stamp = to_time_message(pair.sample.stamp_ns)
        state = JointState(
            name=list(SLOTS),
            position=list(pair.sample.pulled_m),
            velocity=[0.0] * 3,
            effort=[float(n) for n in pair.sample.tension_n],
        )
        state.header.stamp = stamp
        self._state.publish(state)
        predicted = FingerStates(
            fingers=[
                FingerState(
                    finger=name,
                    profile=self.profile,
                    pulled_length=pair.free.pulled_m[slot],
                    tension=pair.free.tension_n[slot],
                    tip=Point(x=pair.free.tip_m[slot][0], y=pair.free.tip_m[slot][1], z=0.0),
                )
                for slot, name in enumerate(SLOTS)
            ],
            friction_model="synthetic",
        )
        predicted.header.stamp = stamp
        self._predicted.publish(predicted)
        status = TendonStatusArray(
            tendons=[
                TendonStatus(tendon=name, state=TendonStatus.HOLDING, homed=True, fault=self.fault, reason="scripted")
                for name in SLOTS
            ],
            estop=self.estop,
        )
        status.header.stamp = stamp
        self._status.publish(status)
        for entry in list(self._goals):
            handle, targets, done = entry
            there = all(self.bench.pulled_m[slot] >= target - 1e-9 for slot, target in targets)
            if handle.is_cancel_requested:
                self.bench.obey(Step(Phase.DONE, (Stop(),)))
            if there or handle.is_cancel_requested:
                self._goals.remove(entry)
                done.set_result(MoveTendon.Result.REACHED if there else MoveTendon.Result.CANCELLED)


class Cell:
    """The manager's process, the scripted driver and a controller."""

    def __init__(self, folder: Path, bench: Any) -> None:
        self.url = f"sqlite:///{folder}/cell.db"
        self.driver = ScriptedDriver(bench)
        self.node = Node("controller")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.driver)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self._spin, daemon=True)
        self.stopping = False
        self.thread.start()
        self.controller = CellController(self.node, self.wait)
        self.process: subprocess.Popen[str] | None = None

    def _spin(self) -> None:
        while not self.stopping:
            self.executor.spin_once(timeout_sec=0.1)

    def wait(self, future: Any, timeout_s: float, expected: str) -> Any:
        until(future.done, timeout_s, expected)
        return future.result()

    def start(self, *parameters: str, mode: int = CellState.IDLE) -> None:
        self.driver.cell = None
        settings = [f"database_url:={self.url}", "lift_window_s:=0.3", "check_speed_m_per_s:=0.08", *parameters]
        arguments = [argument for setting in settings for argument in ("-p", setting)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "softgrip_cell.nodes.grasp_mix_manager", "--ros-args", *arguments],
            stderr=subprocess.PIPE,
            text=True,
        )
        until(lambda: self.driver.cell is not None, 20.0, "cell/state", self.process)
        self.state(lambda state: state.mode == mode, f"mode {mode}")

    def stop(self, how: signal.Signals = signal.SIGINT) -> str:
        assert self.process is not None
        self.process.send_signal(how)
        _, errors = self.process.communicate(timeout=15)
        self.code, self.process = self.process.returncode, None
        return errors

    def integrity(self) -> str:
        with sqlite3.connect(self.url.removeprefix("sqlite:///")) as connection:
            return str(connection.execute("PRAGMA integrity_check").fetchone()[0])

    def close(self) -> None:
        if self.process is not None:
            self.stop(signal.SIGKILL)
        self.stopping = True
        self.thread.join()
        self.executor.shutdown()
        self.driver.destroy_node()
        self.node.destroy_node()

    def swap(self, finger_set: str = "power", prefix: str = "PW", **options: Any) -> Any:
        serials = [f"{prefix}-{name[0].upper()}-01" for name in SLOTS]
        return self.controller.swap(finger_set, lambda step, _: serials if step == "insert" else [], **options)

    def state(self, condition: Callable[[Any], bool], expected: str) -> CellState:
        until(lambda: self.driver.cell is not None and condition(self.driver.cell), 10.0, f"cell/state with {expected}")
        assert self.driver.cell is not None
        return self.driver.cell


def until(condition: Callable[[], bool], timeout_s: float, expected: str, process: Any = None) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if process is not None and process.poll() is not None:
            pytest.fail(f"the manager ended with {process.returncode}: {process.stderr.read()}")
        assert time.monotonic() < deadline, f"expected {expected} within {timeout_s} s"
        time.sleep(0.01)


@pytest.fixture
def cell(tmp_path: Path, bench: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("EMBEDDED_ROUTER_PORT", str(free.getsockname()[1]))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 200 + 20))
    rclpy.init()
    made = Cell(tmp_path, bench())
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown()


def test_a_shift_from_an_unknown_hand_to_a_gripped_orange(cell: Cell) -> None:
    cell.start()
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert {mounted.state for mounted in state.mounted} == {MountedFinger.UNKNOWN}
    choice = cell.controller.select("orange")
    assert (choice.grasp, choice.swap_needed) == ("power", True)
    refused = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[refused.outcome] == "ABORTED"
    assert "slot index is unknown; run cell/swap" in refused.reason

    swapped = cell.swap()
    assert swapped.outcome == SwapFingers.Result.SUCCEEDED, swapped.reason
    assert [(m.serial, m.state) for m in swapped.mounted] == [
        (f"PW-{name[0].upper()}-01", MountedFinger.VERIFIED) for name in SLOTS
    ]
    assert not cell.controller.select("orange").swap_needed

    empty = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[empty.outcome] == "EMPTY", empty.reason
    cell.controller.release()

    cell.driver.bench.contact_m = (0.008, 0.009, 0.0085)
    phases: list[str] = []
    gripped = cell.controller.grasp("orange", on_phase=phases.append)
    assert GRASP_OUTCOMES[gripped.outcome] == "GRIPPED", gripped.reason
    assert gripped.latency < 0.1
    assert phases[-2:] == ["hold", "lift"]
    state = cell.state(lambda s: s.picks == 2, "two picks")
    assert (state.mode, state.product, state.gripped, state.empty, state.swaps) == (
        CellState.HOLDING,
        "orange",
        1,
        1,
        1,
    )
    again = cell.controller.grasp("egg")
    assert "'orange' is held; call tendon/release" in again.reason
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")
    cell.stop()
    assert cell.code == 0


def test_the_plan_comes_over_the_service(cell: Cell) -> None:
    cell.start()
    products = ["egg", "grape", "baloney"]
    plan = cell.controller.plan(products, [3, 2, 1])
    assert plan.swaps == 2
    assert list(plan.redundant_sets) == ["hook"]
    assert sorted(step.order for step in plan.steps) == [0, 1, 2]
    with pytest.raises(RefusedError, match="'brick' is not in the mix"):
        cell.controller.plan(["brick"], [1])
    with pytest.raises(RefusedError, match="as many quantities as products"):
        cell.controller.plan(["egg"], [])
    with pytest.raises(RefusedError, match="quantity >= 1, found 0"):
        cell.controller.plan(["egg"], [0])
    with pytest.raises(RefusedError, match="'brick' is not in the mix"):
        cell.controller.select("brick")


def run_manager(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a manager that is expected to end by itself."""
    command = [sys.executable, "-m", "softgrip_cell.nodes.grasp_mix_manager", "--ros-args", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


SWAP_KILLS = {
    # step in which the manager dies: (state of the slots after the restart, prefix of the serials that it names)
    "release": (MountedFinger.TO_BE_VERIFIED, "PW"),
    "open_palm": (MountedFinger.UNKNOWN, "PW"),
    "remove": (MountedFinger.UNKNOWN, "PW"),
    "insert": (MountedFinger.UNKNOWN, ""),
    "close_palm": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "home": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "verify": (MountedFinger.TO_BE_VERIFIED, "PI"),
}


@pytest.mark.parametrize("step", SWAP_KILLS)
def test_kill_9_in_a_swap_leaves_the_truth_or_unknown(cell: Cell, step: str) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.blocked = {step}
    reached = threading.Event()
    serials = [f"PI-{name[0].upper()}-01" for name in SLOTS]
    confirm = cell.node.create_client(ConfirmStep, "cell/confirm_step")

    def on_feedback(message: Any) -> None:
        feedback = message.feedback
        if feedback.step == step:
            reached.set()
        elif feedback.confirmation:
            told = serials if feedback.step == "insert" else []
            confirm.call_async(ConfirmStep.Request(step=feedback.step, serials=told))

    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    until(client.server_is_ready, 10.0, "cell/swap")
    client.send_goal_async(SwapFingers.Goal(finger_set="pinch"), feedback_callback=on_feedback)
    assert reached.wait(10.0), f"the swap did not come to step {step}"
    cell.stop(signal.SIGKILL)

    cell.driver.unblock()
    released = cell.driver.released
    cell.start()
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    expected, prefix = SWAP_KILLS[step]
    assert {mounted.state for mounted in state.mounted} == {expected}
    assert [m.serial for m in state.mounted] == [f"{prefix}-{n[0].upper()}-01" if prefix else "" for n in SLOTS]
    assert f"restarted during swap 'pinch' at step '{step}'" in state.reason
    until(lambda: cell.driver.released > released, 10.0, "the tendons to be released")
    assert "cell/swap" in cell.controller.grasp("egg").reason
    assert cell.integrity() == "ok"


@pytest.mark.parametrize("phase", ["close", "lift"])
def test_kill_9_in_a_grasp_lets_nobody_grasp_before_the_fingers_were_opened(cell: Cell, phase: str) -> None:
    cell.start("lift_window_s:=30.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.004, 0.004, 0.004)
    reached = threading.Event()
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    until(client.server_is_ready, 10.0, "cell/grasp")
    client.send_goal_async(
        Grasp.Goal(product="orange", confirm_lift=True),
        feedback_callback=lambda message: reached.set() if message.feedback.phase == phase else None,
    )
    assert reached.wait(10.0)
    released = cell.driver.released
    cell.stop(signal.SIGKILL)

    cell.start(mode=CellState.UNKNOWN)
    state = cell.state(lambda s: s.product == "orange", "the product that may be held")
    assert {mounted.state for mounted in state.mounted} == {MountedFinger.TO_BE_VERIFIED}
    assert "a product may be held: call tendon/release" in cell.controller.grasp("egg").reason
    assert cell.driver.released == released, "nobody but a person may let go of what may be held"
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE and s.product == "", "mode idle after release")
    assert cell.integrity() == "ok"


def test_a_second_manager_on_the_same_cell_is_refused(cell: Cell) -> None:
    cell.start()
    first, cell.process = cell.process, None
    other = subprocess.run(
        [
            sys.executable,
            "-m",
            "softgrip_cell.nodes.grasp_mix_manager",
            "--ros-args",
            "-p",
            f"database_url:={cell.url}",
        ],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    cell.process = first
    assert other.returncode == 2
    assert "another grasp_mix_manager runs this cell" in other.stderr


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [
        ("catalogue:=/nowhere.yaml", "cannot be read"),
        ("database_url:=oracle://x", "expected sqlite or postgresql"),
        ("lift_window_s:=-1.0", "lift_window_s"),
        ("thumb:=toe", "expected different names with 'toe'"),
    ],
)
def test_a_manager_that_cannot_start_says_why(cell: Cell, parameter: str, expected: str) -> None:
    done = run_manager("-p", f"database_url:={cell.url}", "-p", parameter)
    assert done.returncode == 2
    assert expected in done.stderr


def test_refusals_name_what_is_wrong(cell: Cell) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED

    def reason(product: str = "egg", **options: Any) -> str:
        result = cell.controller.grasp(product, **options)
        assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
        return str(result.reason)

    assert "product 'brick' is not in the mix; known are apple" in reason("brick")
    assert "finger set 'power' does not hold 'grape'" in reason("grape")
    assert "expected one of the finger sets power, pinch, hook, found 'claw'" in cell.swap("claw").reason
    cell.driver.publish_friction(age_s=90 * 86400.0)
    until(lambda: "days old, the limit is 30.0 days" in reason(), 5.0, "a refusal for age")
    cell.driver.publish_friction(model="other")
    until(lambda: "checked with friction model 'synthetic', active is 'other'" in reason(), 5.0, "another model")
    cell.driver.publish_friction(high_n=1.0)
    until(lambda: "is trusted up to 5.0 N" in reason(), 5.0, "a refusal for range")
    cell.driver.publish_friction()
    cell.driver.fault = "overload"
    cell.state(lambda s: s.mode == CellState.FAULT and "overload" in s.fault, "mode fault")
    assert "the driver has a fault: index: overload: scripted" in reason()
    assert "the driver has a fault" in cell.swap().reason
    cell.driver.fault = ""
    cell.driver.estop = True
    cell.state(lambda s: s.mode == CellState.ESTOP, "mode estop")
    assert "the emergency stop is latched" in reason()
    cell.driver.estop = False
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    # A trial may do what is known to fail.
    tried = cell.controller.grasp("grape", trial=True)
    assert GRASP_OUTCOMES[tried.outcome] == "EMPTY"


def test_a_fault_in_a_grasp_ends_it_as_a_tendon_fault_and_a_cancel_as_aborted(cell: Cell) -> None:
    cell.start("lift_window_s:=30.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.004, 0.004, 0.004)

    def on_phase(phase: str) -> None:
        if phase == "lift":
            cell.driver.fault = "overheated"

    result = cell.controller.grasp("orange", on_phase=on_phase)
    assert GRASP_OUTCOMES[result.outcome] == "TENDON_FAULT"
    assert "tendon index: overheated" in result.reason
    cell.driver.fault = ""
    cell.state(lambda s: s.mode == CellState.IDLE and s.tendon_faults == 1, "one tendon fault counted")

    client = ActionClient(cell.node, Grasp, "cell/grasp")
    goal = client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True))
    handle = cell.wait(goal, 5.0, "a goal handle")
    cell.state(lambda s: s.mode == CellState.GRASPING, "mode grasping")
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    answer = cell.wait(handle.get_result_async(), 5.0, "a result")
    assert GRASP_OUTCOMES[answer.result.outcome] == "ABORTED"
    assert "cancelled by the client; the fingers stay where they are" in answer.result.reason


def test_a_cancelled_swap_states_its_safe_condition(cell: Cell) -> None:
    cell.start()
    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    until(client.server_is_ready, 10.0, "cell/swap")
    asked = threading.Event()
    goal = client.send_goal_async(
        SwapFingers.Goal(finger_set="power"),
        feedback_callback=lambda message: asked.set() if message.feedback.step == "open_palm" else None,
    )
    handle = cell.wait(goal, 5.0, "a goal handle")
    assert asked.wait(5.0)
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    answer = cell.wait(handle.get_result_async(), 5.0, "a result")
    assert answer.result.outcome == SwapFingers.Result.CANCELLED
    assert "tendons slack, fingers as before but to be verified" in answer.result.reason
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")


def test_a_swap_that_takes_too_long_fails(cell: Cell) -> None:
    cell.start("swap_limit_s:=5.0")
    result = cell.controller.swap("power", lambda step, _: ["wrong"] * 3 if step == "insert" else [], timeout_s=20.0)
    assert result.outcome == SwapFingers.Result.FAILED
    assert "not done within 5 s, at step 'insert'; tendons slack, palm open, slots unknown" in result.reason
