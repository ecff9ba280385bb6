# SPDX-License-Identifier: Apache-2.0
"""The manager as a process of its own, against a scripted driver and predictor on the bench of ../conftest.py."""

from __future__ import annotations

import resource
import secrets
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
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

from softgrip_cell.grasp.commands import Close, Open, Press, Stop
from softgrip_cell.grasp.sequence import GraspStep
from softgrip_cell.grasp.values import GraspPhase
from softgrip_cell.nodes.controller_client import CellController
from softgrip_cell.nodes.convert import CONFIRMATIONS
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import (
    CellState,
    FingerState,
    FingerStates,
    FrictionModel,
    LeaseHeartbeat,
    PredictionResidual,
    SafetyState,
    TendonOwner,
    TendonOwners,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_interfaces.srv import AcquireLease, AcquireLock, ConfirmStep, ReleaseLease, ReleaseLock
from softgrip_model.friction.acceptance import accept
from softgrip_nodekit import LATCHED, SENSOR, to_time_message
from softgrip_testing.free_domains import own_domain

SLOTS = ("index", "middle", "thumb")
#: Between two looks of the scripted driver at most so much counts as an owner's silence [s]: in a longer pause this
#: process did not run, and heartbeats wait to be read.
MAX_LOOK_S = 0.05


class Guard:
    """What keeps the tendons from moving: emergency stop, lock, lease; as the texts of the interfaces say."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.safety = node.create_publisher(SafetyState, "safety/state", LATCHED)
        self._owners = node.create_publisher(TendonOwners, "tendon/owners", LATCHED)
        node.create_service(AcquireLease, "tendon/lease", self._on_lease)
        node.create_service(ReleaseLease, "tendon/lease_release", self._on_lease_release)
        node.create_subscription(LeaseHeartbeat, "tendon/heartbeat", self._on_heartbeat, 10)
        self._sequence = 0
        self._estop = False
        self.lock_token = ""
        self.lock_owner = ""
        self.lock_reason = ""
        self.lease_token = ""
        self.lease_owner = ""
        self.requested_by = ""
        self.heartbeats = 0
        self._duration_s = 0.0
        self._silent_s = self._looked_s = 0.0
        self.publish()
        self._publish_owners()

    @property
    def estop(self) -> bool:
        return self._estop

    @estop.setter
    def estop(self, latched: bool) -> None:
        self._estop = latched
        self.publish()

    @property
    def locked(self) -> bool:
        return bool(self.lock_token)

    def publish(self) -> None:
        self._sequence += 1
        message = SafetyState(
            sequence=self._sequence,
            estop=self._estop,
            estop_reason="scripted" if self._estop else "",
            locked=self.locked,
            lock_owner=self.lock_owner,
            lock_reason=self.lock_reason,
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self.safety.publish(message)

    def refusal(self, lease: str = "", *, leased: bool = True) -> str:
        """Why an order is refused, empty when it is not."""
        if self._estop:
            return "the emergency stop is latched"
        if self.locked:
            return f"the drives are locked by '{self.lock_owner}'"
        if leased and lease != self.lease_token:
            return f"the tendons are owned by '{self.lease_owner or 'nobody'}'"
        return ""

    def lock(self, request: Any, response: Any) -> Any:
        if request.token:
            response.success = request.token == self.lock_token
            response.message = "it stands" if response.success else "no such lock"
        elif self.locked:
            response.message = f"locked by '{self.lock_owner}': {self.lock_reason}"
        else:
            self.lock_token = secrets.token_hex(8)
            self.lock_owner, self.lock_reason = request.owner, request.reason
            response.success, response.token = True, self.lock_token
            self.publish()
        return response

    def unlock(self, request: Any, response: Any) -> Any:
        overridden = request.override_owner and self._estop and request.reason
        if self.locked and (request.token == self.lock_token or overridden):
            self.lock_token = self.lock_owner = self.lock_reason = ""
            response.success = True
            self.publish()
        else:
            response.message = "not the owner's token"
        return response

    def take_lease(self, owner: str, duration_s: float = 60.0) -> None:
        """Give the tendons to somebody, whoever had them."""
        self.lease_token, self.lease_owner = secrets.token_hex(8), owner
        self._duration_s, self._silent_s = duration_s, 0.0
        self.requested_by = ""
        self._publish_owners()

    def ask_for_hand_over(self, name: str) -> None:
        self.requested_by = name
        self._publish_owners()

    def end_lease(self) -> None:
        self.lease_token = self.lease_owner = ""
        self._publish_owners()

    def watch(self) -> None:
        """End a lease whose owner sends no heartbeats."""
        now_s = time.monotonic()
        self._silent_s += min(now_s - self._looked_s, MAX_LOOK_S)
        self._looked_s = now_s
        if self.lease_token and self._silent_s > self._duration_s:
            self.end_lease()

    def _on_lease(self, request: Any, response: Any) -> Any:
        if self.lease_token:
            response.message = f"the tendons are owned by '{self.lease_owner}'"
        else:
            self.take_lease(request.owner, request.duration)
            response.success, response.token, response.duration = True, self.lease_token, request.duration
        return response

    def _on_lease_release(self, request: Any, response: Any) -> Any:
        response.success = bool(self.lease_token) and request.token == self.lease_token
        if response.success:
            self.end_lease()
        return response

    def _on_heartbeat(self, message: Any) -> None:
        if message.token == self.lease_token:
            self.heartbeats += 1
            self._silent_s = 0.0

    def _publish_owners(self) -> None:
        message = TendonOwners(
            owners=[
                TendonOwner(
                    tendon=name, owner=self.lease_owner, duration=self._duration_s, requested_by=self.requested_by
                )
                for name in SLOTS
            ]
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._owners.publish(message)


class ScriptedDriver(Node):
    """Driver, predictor and friction rig in one node; the bench says what the tendons feel."""

    def __init__(self, bench: Any) -> None:
        super().__init__("scripted_driver")
        self.bench = bench
        self.guard = Guard(self)
        self.refused: list[str] = []
        self.moved = 0
        self.tendon_state = TendonStatus.HOLDING
        self.status_tells_estop = True
        self.goals: list[Any] = []
        self.status_quiet = False
        self.predicts = True
        self.spoil: Callable[[JointState], None] = lambda _: None
        self.release_fails = ""
        self.digest = ""  # of the friction model that the scripted predictor computes with
        self.profile = "power"
        self.fault = ""
        self.quiet = False
        self.released = 0
        self.blocked: set[str] = set()
        self._gates: list[Future] = []
        self._goals: list[tuple[Any, tuple[float, ...], Future]] = []
        self._state = self.create_publisher(JointState, "tendon/state", SENSOR)
        self._status = self.create_publisher(TendonStatusArray, "tendon/status", SENSOR)
        self._predicted = self.create_publisher(FingerStates, "finger/predicted", SENSOR)
        self._residual = self.create_publisher(PredictionResidual, "finger/residual", SENSOR)
        self._friction = self.create_publisher(FrictionModel, "friction/active", LATCHED)
        self.create_service(Trigger, "tendon/release", self._on_release)
        self.create_service(Trigger, "tendon/home", self._on_home)
        self.create_service(AcquireLock, "tendon/lock", self._on_lock)
        self.create_service(ReleaseLock, "tendon/unlock", self._on_unlock)
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

    def is_heard(self) -> bool:
        """Whether somebody has found the topics that tell of the tendons; DDS needs a moment for that."""
        topics = (self._state, self._status, self._predicted, self._residual, self._friction, self.guard.safety)
        return all(publisher.get_subscription_count() > 0 for publisher in topics)

    def publish_residual(self, finger: str, verdict: int, reason: str) -> None:
        """Say what the predictor would of a finger."""
        message = PredictionResidual(finger=finger, verdict=verdict, reason=reason)
        message.header.stamp = self.get_clock().now().to_msg()
        self._residual.publish(message)

    def publish_friction(self, *, age_s: float = 60.0, **changes: Any) -> None:
        stamp = to_time_message(self.get_clock().now().nanoseconds - int(age_s * 1e9))
        message = friction_model(**changes)
        self.digest = accept(message).digest
        message.header.stamp = stamp
        self._friction.publish(message)

    def publish_state(self, pulled_length_m: Sequence[float]) -> None:
        """Say once what somebody else's node would: that the tendons are there."""
        state = JointState(name=list(SLOTS), position=list(pulled_length_m), velocity=[0.0] * 3, effort=[0.0] * 3)
        state.header.stamp = self.get_clock().now().to_msg()
        self._state.publish(state)

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

    async def _on_lock(self, request: Any, response: Any) -> Any:
        if "lock" in self.blocked and not request.token:
            await self._blocked()
            return response
        return self.guard.lock(request, response)

    async def _on_unlock(self, request: Any, response: Any) -> Any:
        if "unlock" in self.blocked:
            await self._blocked()
            return response
        return self.guard.unlock(request, response)

    async def _on_release(self, _request: Any, response: Any) -> Any:
        if "release" in self.blocked:
            await self._blocked()
            return response
        response.message = self.release_fails or self.guard.refusal(leased=False)
        if response.message:
            self.refused.append(f"release: {response.message}")
            return response
        self.released += 1
        self.bench.obey(GraspStep(GraspPhase.APPROACH, (Open(),)))
        response.success = True
        return response

    async def _on_home(self, _request: Any, response: Any) -> Any:
        if "home" in self.blocked:
            await self._blocked()
            return response
        response.message = self.guard.refusal(leased=False)
        response.success = not response.message
        if response.message:
            self.refused.append(f"home: {response.message}")
        return response

    def _refusal(self, goal: Any) -> str:
        """What the interface of tendon/move says about orders that are refused."""
        now_ns = self.get_clock().now().nanoseconds
        deadline_ns = goal.deadline.sec * 1_000_000_000 + goal.deadline.nanosec
        if goal.mode not in (goal.LENGTH, goal.TENSION):
            return f"expected a mode, found {goal.mode}"
        if not goal.speed > 0.0:
            return f"expected a speed, found {goal.speed}"
        if goal.mode == goal.LENGTH and not goal.tension_limit > 0.0:
            return f"expected a tension limit, found {goal.tension_limit}"
        if deadline_ns and now_ns > deadline_ns:
            return "too late"
        return self.guard.refusal(goal.lease)

    async def _move(self, handle: Any) -> MoveTendon.Result:
        goal = handle.request
        self.goals.append(goal)
        why_not = self._refusal(goal)
        if why_not:
            self.refused.append(f"move: {why_not}")
            handle.abort()
            return MoveTendon.Result(outcome=MoveTendon.Result.REFUSED, reason=why_not)
        self.moved += 1
        tendons = list(goal.tendons) or list(SLOTS)
        slots = tuple(SLOTS.index(name) for name in tendons)
        targets = tuple(goal.targets) if len(goal.targets) == len(slots) else tuple(goal.targets) * len(slots)
        if goal.mode == goal.TENSION:
            self.bench.obey(GraspStep(GraspPhase.HOLD, (Press(slots, targets, goal.speed),)))
            handle.succeed()
            return MoveTendon.Result(outcome=MoveTendon.Result.REACHED)
        if max(targets) == 0.0:
            if "open" in self.blocked:
                await self._blocked()
            self.bench.obey(GraspStep(GraspPhase.APPROACH, (Open(),)))
            handle.succeed()
            return MoveTendon.Result(outcome=MoveTendon.Result.REACHED)
        self.bench.obey(GraspStep(GraspPhase.CLOSE, (Close(slots, targets, goal.speed, goal.tension_limit),)))
        done = Future()
        self._goals.append((handle, tuple(zip(slots, targets, strict=True)), done))
        outcome = await done
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return MoveTendon.Result(outcome=outcome)

    def _tick(self) -> None:
        self.guard.watch()
        if self.quiet:
            return
        self.bench.now_ns = self.get_clock().now().nanoseconds - 5_000_000
        pair = self.bench.pair()
        stamp = to_time_message(pair.sample.stamp_ns)
        state = JointState(
            name=list(SLOTS),
            position=list(pair.sample.pulled_length_m),
            velocity=[0.0] * 3,
            effort=[float(n) for n in pair.sample.tension_n],
        )
        state.header.stamp = stamp
        self.spoil(state)
        self._state.publish(state)
        predicted = FingerStates(
            fingers=[
                FingerState(
                    finger=name,
                    profile=self.profile,
                    pulled_length=pair.free.pulled_length_m[slot],
                    tension=pair.free.tension_n[slot],
                    tip=Point(x=pair.free.tip_m[slot][0], y=pair.free.tip_m[slot][1], z=0.0),
                )
                for slot, name in enumerate(SLOTS)
            ],
            friction_model="synthetic",
            friction_digest=self.digest,
        )
        predicted.header.stamp = stamp
        if self.predicts:
            self._predicted.publish(predicted)
        if not self.status_quiet:
            self._publish_status(stamp)
        self._end_goals()

    def _publish_status(self, stamp: Any) -> None:
        status = TendonStatusArray(
            tendons=[
                TendonStatus(tendon=name, state=self.tendon_state, homed=True, fault=self.fault, reason="scripted")
                for name in SLOTS
            ],
            estop=self.guard.estop and self.status_tells_estop,
        )
        status.header.stamp = stamp
        self._status.publish(status)

    def _end_goals(self) -> None:
        for entry in list(self._goals):
            handle, targets, done = entry
            there = all(self.bench.pulled_length_m[slot] >= target - 1e-9 for slot, target in targets)
            if handle.is_cancel_requested:
                self.bench.obey(GraspStep(GraspPhase.DONE, (Stop(),)))
            if there or handle.is_cancel_requested:
                self._goals.remove(entry)
                done.set_result(MoveTendon.Result.REACHED if there else MoveTendon.Result.CANCELLED)


def friction_model(*, model: str = "synthetic", high_n: float = 9.81, **changes: Any) -> FrictionModel:
    """A model that can be true; `mu` is what the scripted prediction has nothing to do with."""
    fields = {
        "id": model,
        "law": "capstan",
        "k_reading": "printed",
        "coefficient_names": ["mu"],
        "coefficients": [0.2],
        "cable_radius": 0.000125,
        "surface_radius": 0.003,
        "angle_range": [0.1, 1.6],
        "tension_range": [0.1, high_n],
        "verdict": FrictionModel.USABLE,
    }
    return FrictionModel(**(fields | changes))


def until(condition: Callable[[], bool], timeout_s: float, expected: str, process: Any = None) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if process is not None and process.poll() is not None:
            pytest.fail(f"the manager ended with {process.returncode}: {process.stderr.read()}")
        assert time.monotonic() < deadline, f"expected {expected} within {timeout_s} s"
        time.sleep(0.01)


class Cell:
    """The manager's process, the scripted driver and a controller."""

    until = staticmethod(until)

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

    def start_with_full_disk(self) -> None:
        """As `start`, where no file can be written from the first moment on."""
        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        self.start(mode=CellState.FAULT, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard)))

    def start(self, *parameters: str, mode: int = CellState.IDLE, **options: Any) -> None:
        self.driver.cell = None
        settings = [f"database_url:={self.url}", "lift_window_s:=0.3", "check_speed_m_per_s:=0.08", *parameters]
        arguments = [argument for setting in settings for argument in ("-p", setting)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "softgrip_cell.nodes.grasp_mix_manager", "--ros-args", *arguments],
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )
        until(lambda: self.driver.cell is not None, 20.0, "cell/state", self.process)
        self.state(lambda state: state.mode == mode, f"mode {mode}")
        until(self.driver.is_heard, 10.0, "the manager's subscriptions to the driver", self.process)

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

    @staticmethod
    def serials(prefix: str) -> list[str]:
        return [f"{prefix}-{name[0].upper()}-01" for name in SLOTS]

    def order(self, lease: str = "") -> tuple[int, str]:
        """What a client that nobody invited is told when it asks for a movement: outcome and reason."""
        client = ActionClient(self.node, MoveTendon, "tendon/move")
        until(client.server_is_ready, 10.0, "tendon/move")
        goal = MoveTendon.Goal(mode=MoveTendon.Goal.LENGTH, targets=[0.005], speed=0.01, tension_limit=5.0, lease=lease)
        handle = self.wait(client.send_goal_async(goal), 10.0, "a goal handle")
        result = self.wait(handle.get_result_async(), 10.0, "a result").result
        return result.outcome, result.reason

    def confirm(self, step: str, token: str, serials: Sequence[str] = ()) -> Any:
        """Answer of cell/confirm_step."""
        client = self.node.create_client(ConfirmStep, "cell/confirm_step")
        until(client.service_is_ready, 10.0, "cell/confirm_step")
        request = ConfirmStep.Request(step=CONFIRMATIONS[step], token=token, serials=list(serials))
        return self.wait(client.call_async(request), 10.0, "an answer of cell/confirm_step")

    def swap(self, finger_set: str = "power", prefix: str = "PW", **options: Any) -> Any:
        serials = self.serials(prefix)
        return self.controller.swap(finger_set, lambda step, _: serials if step == "insert" else [], **options)

    def state(self, condition: Callable[[Any], bool], expected: str) -> CellState:
        until(lambda: self.driver.cell is not None and condition(self.driver.cell), 10.0, f"cell/state with {expected}")
        assert self.driver.cell is not None
        return self.driver.cell


@pytest.fixture
def cell(tmp_path: Path, bench: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    made = Cell(tmp_path, bench())
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown()
