# SPDX-License-Identifier: Apache-2.0
"""The shipped cell on emulated hardware, all of its processes, for as long as a benchmark needs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from softgrip_cell.nodes.controller_client import CellController
from softgrip_demo.nodes.convert import outcome_latency
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.operator import CellOperator
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_nodekit import SENSOR
from softgrip_time import SimulatedClock

START_S = 180.0
END_S = 30.0
SLOTS = ("index", "middle", "thumb")
FINGER_SET = "power"
PRODUCTS = ("egg", "orange", "muffin", "apple", "")
#: A bench's cell file; the emulated servos answer later than real ones.
BENCH = """
schema: 1
hardware: real
servos:
  port: WIRES/servos
  chain:
    - {tendon: index, model: XL330-M288, id: 1, direction: 1}
    - {tendon: middle, model: XL330-M288, id: 2, direction: 1}
    - {tendon: thumb, model: XL330-M288, id: 3, direction: 1}
rig: {stage: {kind: mark10, port: WIRES/stand}, gauge: {kind: gcl2, port: WIRES/gauge}}
camera: {source: "@WIRES/camera.url", calibration: WIRES/camera_calibration.yaml}
parameters:
  tendon_driver: {reply_margin_s: 0.1, no_reply_s: 5.0, bus_watchdog_s: 0.0, loop_rate: 50.0}
"""
CABLE_RADIUS_M, SURFACE_RADIUS_M = 0.000125, 0.003


def _in_domain(domain: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment of a ROS domain in which the commands of this Python's folder are found."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**environment, "ROS_DOMAIN_ID": domain, "PATH": path}


@contextmanager
def cell(
    domain: str, *arguments: str, environment: dict[str, str] | None = None, log: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run the launch file in a ROS domain and a session of its own; its processes are gone afterwards."""
    output = log.open("wb") if log is not None else None
    with tempfile.TemporaryDirectory() as folder:
        launch = subprocess.Popen(
            [
                *("ros2", "launch", "softgrip_bringup", "cell.launch.yaml"),
                *(f"out:={folder}/out", f"wire_dir:={folder}/w", *arguments),
            ],
            env=_in_domain(domain, environment or os.environ),
            stdout=output or subprocess.DEVNULL,
            stderr=subprocess.STDOUT if output else subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            yield launch
        finally:
            launch.send_signal(signal.SIGINT)
            launch.wait(END_S)
            if output is not None:
                output.close()


@contextmanager
def bench(domain: str, *, log: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run the launch file for real hardware, in real time, over the wires of an emulated cell in the next domain."""
    with tempfile.TemporaryDirectory() as folder:
        wires = Path(folder) / "wires"
        devices = subprocess.Popen(
            ["ros2", "run", "softgrip_emulator", "emulated_cell", "--ros-args", "-p", f"wire_dir:={wires}"],
            env=_in_domain(str(int(domain) + 1), os.environ),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            end = time.monotonic() + START_S
            while not (wires / "camera.url").exists():
                if time.monotonic() > end or devices.poll() is not None:
                    raise TimeoutError(f"expected an emulated cell with its wires in {wires}, found none")
                time.sleep(0.1)
            file = Path(folder) / "cell.yaml"
            file.write_text(BENCH.replace("WIRES", str(wires)), encoding="utf-8")
            with cell(domain, f"cell_file:={file}", log=log) as launch:
                yield launch
        finally:
            devices.send_signal(signal.SIGINT)
            devices.wait(END_S)


def cell_time_s(launch: subprocess.Popen[bytes]) -> float:
    """Return the time of an emulated cell that runs [s].

    Raises:
        OSError: its time server is not up.
    """
    assert isinstance(launch.args, list)
    folder = next(argument for argument in map(str, launch.args) if argument.startswith("wire_dir:="))
    return SimulatedClock(Path(folder.partition(":=")[2]) / "time", "benchmark").now_s()


def outcomes_at_client_s(domain: str, grasps: int) -> list[float]:
    """Grasp in a live cell; return how long after the deciding tendon/state each outcome was at its client [s]."""
    os.environ["ROS_DOMAIN_ID"] = domain
    with cell(domain, "lift_window_s:=0.5", "rig_time_scale:=20.0"):
        rclpy.init()
        # in the cell's time, which results are stamped with
        node = Node("grasp_benchmark", parameter_overrides=[Parameter("use_sim_time", value=True)])
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        hands = Hands()
        try:
            return _grasp(node, CellLink(node, executor), hands, grasps)
        finally:
            hands.close()
            executor.shutdown(timeout_sec=2.0)
            node.destroy_node()
            rclpy.try_shutdown()


def _grasp(node: Node, link: CellLink, hands: Hands, grasps: int) -> list[float]:
    seen: list[TendonStatusArray] = []
    node.create_subscription(TendonStatusArray, "tendon/status", seen.append, SENSOR)
    controller = CellController(node, wait=link.wait)
    operator = CellOperator(link, hands, controller, SLOTS)
    # the cell's time is not known before the cell is there
    link.until(lambda: bool(seen), START_S, "tendon/status", Clock(clock_type=ClockType.STEADY_TIME))
    operator.calibrate(CABLE_RADIUS_M, SURFACE_RADIUS_M)
    operator.swap(FINGER_SET)
    delays_s = []
    for number in range(grasps):
        hands.place(PRODUCTS[number % len(PRODUCTS)])
        result = controller.grasp("egg", confirm_lift=bool(number % 2), trial=True)
        delays_s.append(outcome_latency(result, node.get_clock().now().nanoseconds) - result.latency)
        controller.release()
        hands.place("")
    return delays_s
