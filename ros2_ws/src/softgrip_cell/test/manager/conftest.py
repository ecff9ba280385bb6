# SPDX-License-Identifier: Apache-2.0
"""The manager as a process of its own, against a scripted driver and predictor on the bench of ../conftest.py."""

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
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from softgrip_cell.grasp.values import Close, Open, Phase, Press, Step, Stop
from softgrip_cell.nodes.controller_client import CellController
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import (
    CellState,
    FingerState,
    FingerStates,
    FrictionModel,
    PredictionResidual,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_nodekit import LATCHED, SENSOR, to_time_message

SLOTS = ("index", "middle", "thumb")


class ScriptedDriver(Node):
    """Driver, predictor and friction rig in one node; the bench says what the tendons feel."""

    def __init__(self, bench: Any) -> None:
        super().__init__("scripted_driver")
        self.bench = bench
        self.profile = "power"
        self.fault = ""
        self.estop = False
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

    def publish_residual(self, finger: str, verdict: int, reason: str) -> None:
        """Say what the predictor would of a finger."""
        message = PredictionResidual(finger=finger, verdict=verdict, reason=reason)
        message.header.stamp = self.get_clock().now().to_msg()
        self._residual.publish(message)

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
            if "open" in self.blocked:
                await self._blocked()
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
        if self.quiet:
            return
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

    @staticmethod
    def serials(prefix: str) -> list[str]:
        return [f"{prefix}-{name[0].upper()}-01" for name in SLOTS]

    def swap(self, finger_set: str = "power", prefix: str = "PW", **options: Any) -> Any:
        serials = self.serials(prefix)
        return self.controller.swap(finger_set, lambda step, _: serials if step == "insert" else [], **options)

    def state(self, condition: Callable[[Any], bool], expected: str) -> CellState:
        until(lambda: self.driver.cell is not None and condition(self.driver.cell), 10.0, f"cell/state with {expected}")
        assert self.driver.cell is not None
        return self.driver.cell


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
