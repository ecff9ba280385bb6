# SPDX-License-Identifier: Apache-2.0
"""A swap on the emulated cell with hands inside: every foreign order is refused, by the plant's truth nothing pulls.

At each guided step, and after kill -9 of the manager in the middle of one.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_interfaces.action import MoveTendon, SwapFingers
from softgrip_interfaces.msg import CellState, EmulatorTruth, SafetyState
from softgrip_interfaces.srv import AcquireLease, AcquireLock, ConfirmStep, MountFingers, ReleaseLease, ReleaseLock
from softgrip_nodekit import SENSOR

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(240)]

CELL = ("ros2", "launch", "softgrip_bringup", "cell.launch.yaml")
SLOTS = ["index", "middle", "thumb"]
GUIDED = ("open_palm", "remove", "insert", "close_palm")
#: By the plant: without torque a tendon carries no more than what its finger's own spring leaves in it [N], and a
#: finger that nobody pulls stays where it is [m].
SLACK_N, STILL_M = 1.0, 0.0005
LONGEST_S = 60.0


class Stranger:
    """A client that nobody invited, and one that sees the truth."""

    def __init__(self, domain: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self.node = rclpy.create_node("stranger", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.safety: SafetyState | None = None
        self.cell: CellState | None = None
        self.truths: list[EmulatorTruth] = []
        self.feedback: queue.Queue[Any] = queue.Queue()
        self.node.create_subscription(SafetyState, "safety/state", lambda m: setattr(self, "safety", m), latched)
        self.node.create_subscription(CellState, "cell/state", lambda m: setattr(self, "cell", m), latched)
        self.node.create_subscription(EmulatorTruth, "emulator/truth", self.truths.append, SENSOR)
        self.stream = self.node.create_publisher(JointTrajectory, "tendon/trajectory", 10)
        self.move = ActionClient(self.node, MoveTendon, "tendon/move")
        self.swap = ActionClient(self.node, SwapFingers, "cell/swap")
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        self._context.try_shutdown()
        self._thread.join()

    def until(self, condition: Callable[[], Any], expected: str, timeout_s: float = LONGEST_S) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"expected {expected} within {timeout_s:g} s; the cell: {self.cell}"
            threading.Event().wait(0.02)

    def result(self, future: Any, expected: str) -> Any:
        self.until(future.done, expected)
        return future.result()

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        try:
            self.until(client.service_is_ready, f"service {name}")
            return self.result(client.call_async(request), f"an answer of {name}")
        finally:
            self.node.destroy_client(client)

    def confirm(self, step: str, token: str, serials: tuple[str, ...] = ()) -> Any:
        number = getattr(ConfirmStep.Request, step.upper())
        request = ConfirmStep.Request(step=number, token=token, serials=serials)
        return self.call(ConfirmStep, "cell/confirm_step", request)

    def begin_swap(self, finger_set: str) -> Any:
        """Send the goal; its feedback comes into the queue. Returns the future of its result."""
        self.until(self.swap.server_is_ready, "cell/swap")
        goal = SwapFingers.Goal(finger_set=finger_set)
        sent = self.swap.send_goal_async(goal, feedback_callback=lambda m: self.feedback.put(m.feedback))
        return self.result(sent, "a goal handle").get_result_async()

    def step(self, requested: str) -> Any:
        """Wait for the feedback of a step."""
        while True:
            feedback = self.feedback.get(timeout=LONGEST_S)
            if feedback.step == getattr(SwapFingers.Feedback, requested.upper()):
                return feedback

    def seat(self, finger_set: str) -> tuple[str, ...]:
        """Put fingers into the slots of the emulated hand, or take them out (empty); returns their serials."""
        prefix = {"power": "PW", "pinch": "PI"}.get(finger_set)
        serials = [f"{prefix}-{slot[0].upper()}-01" if prefix else "" for slot in SLOTS]
        request = MountFingers.Request(fingers=SLOTS, serials=serials, profiles=[finger_set] * len(SLOTS))
        assert self.call(MountFingers, "emulator/mount", request).success
        return tuple(serials)


def order_everything(stranger: Stranger) -> None:
    """Try all that moves a tendon, ends the lock or goes on with the swap; each has to be refused."""
    lease = AcquireLease.Request(owner="stranger", duration=1.0, force=True, reason="because")
    taken = stranger.call(AcquireLease, "tendon/lease", lease)  # whoever owns the tendons, the lock is stronger
    for token in {"", "guessed", taken.token}:
        goal = MoveTendon.Goal(mode=MoveTendon.Goal.LENGTH, targets=[0.006], speed=0.05, tension_limit=8.0, lease=token)
        handle = stranger.result(stranger.move.send_goal_async(goal), "a goal handle")
        moved = stranger.result(handle.get_result_async(), "a result").result
        assert moved.outcome == MoveTendon.Result.REFUSED, moved.reason
        assert "locked by grasp_mix_manager" in moved.reason
    point = JointTrajectoryPoint(positions=[0.006] * 3)
    point.time_from_start.nanosec = 200_000_000
    streamed = JointTrajectory(joint_names=SLOTS, points=[point])
    streamed.header.frame_id = taken.token
    stranger.stream.publish(streamed)
    for name in ("tendon/home", "tendon/release"):
        assert not stranger.call(Trigger, name, Trigger.Request()).success, name
    stranger.call(ReleaseLease, "tendon/lease_release", ReleaseLease.Request(token=taken.token))
    locked = AcquireLock.Request(owner="stranger", reason="mine")
    assert not stranger.call(AcquireLock, "tendon/lock", locked).success
    for request in (
        ReleaseLock.Request(token="guessed"),
        ReleaseLock.Request(token="", override_owner=True, reason="no stop is latched"),
    ):
        assert not stranger.call(ReleaseLock, "tendon/unlock", request).success
    for step in (*GUIDED, "hands_out"):
        assert not stranger.confirm(step, "guessed").success


def pulls_nothing(stranger: Stranger) -> None:
    """By the truth of the plant no tendon pulls and no finger moves while a stranger orders everything."""
    assert stranger.safety is not None
    assert stranger.safety.locked
    stranger.truths.clear()
    stranger.until(lambda: len(stranger.truths) > 2, "the truth")
    order_everything(stranger)
    count = len(stranger.truths)
    stranger.until(lambda: len(stranger.truths) > count + 10, "the truth after the orders")
    for finger in {state.finger for truth in stranger.truths for state in truth.fingers}:
        states = [state for truth in stranger.truths for state in truth.fingers if state.finger == finger]
        pulled = [state.pulled_length for state in states]
        assert max(state.tension for state in states) < SLACK_N
        assert max(pulled) - min(pulled) < STILL_M


@pytest.fixture
def stranger(launch: Callable[..., Any], tmp_path: Path) -> Iterator[tuple[Any, Stranger]]:
    launched = launch(*CELL, f"out:={tmp_path}/out")
    made = Stranger(launched.domain)
    try:
        made.until(lambda: made.cell is not None and made.cell.mode == CellState.IDLE, "a cell that is idle")
        made.until(lambda: made.safety is not None, "safety/state")
        yield launched, made
    finally:
        made.close()


def test_with_hands_inside_nothing_moves_whoever_orders_it_at_every_step_and_after_a_kill(
    stranger: tuple[Any, Stranger],
) -> None:
    launched, person = stranger
    ended = person.begin_swap("power")
    for step in GUIDED:
        feedback = person.step(step)
        if step != "remove":
            serials = person.seat("power") if step == "insert" else ()
        else:
            person.seat("")
        pulls_nothing(person)
        assert person.confirm(step, feedback.token, serials if step == "insert" else ()).success
    result = person.result(ended, "the end of the swap").result
    assert result.outcome == SwapFingers.Result.SUCCEEDED, result.reason
    assert not person.safety.locked

    person.begin_swap("pinch")
    token = person.step("open_palm").token
    assert person.confirm("open_palm", token).success
    person.step("remove")
    killed = launched.node_process("grasp_mix_manager")
    os.kill(killed, signal.SIGKILL)
    person.until(lambda: launched.node_process("grasp_mix_manager") not in {None, killed}, "a new manager")
    person.until(lambda: person.cell.mode == CellState.SWAPPING and "restarted" in person.cell.reason, "its state")
    pulls_nothing(person)
    assert person.confirm("hands_out", token).success
    person.until(lambda: not person.safety.locked, "the drives to be unlocked")
    person.until(lambda: person.cell.mode == CellState.IDLE, "mode idle")
