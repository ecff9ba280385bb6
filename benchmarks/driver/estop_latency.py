# SPDX-License-Identifier: Apache-2.0
"""From a client's estop to torque off, by the truth of the emulated servos, beside strangers who flood the driver.

Each load runs in a process of its own: messages of 100 MB on tendon/trajectory, malformed requests to estop and
estop_reset, a thousand moves one after another, a grasp_mix_manager that is frozen (SIGSTOP). The peer is the same
without any load, in the same run.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from _emulated_drives import Servos, emulated_servos, start_driver

from softgrip_testing.benchmark_claim import claim

DOMAIN = 214
COUNT = 200
ANSWER_S = 30.0
BIG_BYTES = 100_000_000
GOALS = 1000
#: [1/s]
MALFORMED_RATE = 10_000.0
GOAL_S = 0.050


def _flood_big(domain: int, stop: Any) -> None:
    """Send 100 MB as one trajectory, again and again."""
    from _hostile import Stranger  # noqa: PLC0415  opens a session where it is imported for

    stranger = Stranger(domain)
    key = next(target.key for target in stranger.targets() if target.name == "/tendon/trajectory")
    payload = bytes(BIG_BYTES)
    while not stop.is_set():
        stranger.session.put(key, payload)
        time.sleep(0.05)
    stranger.close()


def _flood_malformed(domain: int, stop: Any) -> None:
    """Send requests that are none, at a rate, without waiting for answers."""
    from _hostile import Stranger  # noqa: PLC0415

    stranger = Stranger(domain)
    keys = [t.key for t in stranger.targets() if t.name in {"/estop", "/estop_reset", "/tendon/lock"}]
    sent, began = 0, time.monotonic()
    while not stop.is_set():
        stranger.session.get(keys[sent % len(keys)], lambda _reply: None, payload=b"\x00\x01nonsense", timeout=1.0)
        sent += 1
        ahead = sent / MALFORMED_RATE - (time.monotonic() - began)
        if ahead > 0.001:
            time.sleep(ahead)
    stranger.close()


def _flood_goals(domain: int, stop: Any) -> None:
    """Send moves one after another."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    import rclpy  # noqa: PLC0415
    from rclpy.action import ActionClient  # noqa: PLC0415

    from softgrip_interfaces.action import MoveTendon  # noqa: PLC0415

    sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115  most goals are refused (the driver is busy), each with a line
    rclpy.init()
    node = rclpy.create_node("goals")
    client = ActionClient(node, MoveTendon, "tendon/move")
    client.wait_for_server(timeout_sec=ANSWER_S)
    goal = MoveTendon.Goal(mode=MoveTendon.Goal.LENGTH, targets=[0.001], speed=0.02, tension_limit=10.0)
    sent = 0
    while not stop.is_set():
        if sent < GOALS:
            client.send_goal_async(goal)
            sent += 1
        rclpy.spin_once(node, timeout_sec=0.0005)
        sent %= GOALS
    node.destroy_node()
    rclpy.try_shutdown()


def _freeze_manager(domain: int, stop: Any) -> None:
    """Start the node that orders grasps, and stop its process once its service is there."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    import rclpy  # noqa: PLC0415

    from softgrip_interfaces.srv import PlanMix  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node("freezer")
    with tempfile.TemporaryDirectory() as folder:
        database = f"database_url:=sqlite:///{folder}/cell.db"
        manager = subprocess.Popen(
            [sys.executable, "-m", "softgrip_cell.nodes.grasp_mix_manager", "--ros-args", "-p", database],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            assert node.create_client(PlanMix, "cell/plan_mix").wait_for_service(timeout_sec=ANSWER_S)
            manager.send_signal(signal.SIGSTOP)
            stop.wait()
        finally:
            manager.kill()
            manager.wait(ANSWER_S)
    node.destroy_node()
    rclpy.try_shutdown()


LOADS: dict[str, Callable[[int, Any], None] | None] = {
    "no load": None,
    "100 MB messages": _flood_big,
    "malformed requests": _flood_malformed,
    "1,000 goals": _flood_goals,
    "frozen manager": _freeze_manager,
}


@contextmanager
def load(flood: Callable[[int, Any], None] | None) -> Iterator[None]:
    """Run a flood in a process of its own."""
    if flood is None:
        yield
        return
    spawn = multiprocessing.get_context("spawn")
    stop = spawn.Event()
    process = spawn.Process(target=flood, args=(DOMAIN, stop), daemon=True)
    process.start()
    time.sleep(2.0)
    try:
        yield
    finally:
        stop.set()
        process.join(10.0)
        if process.is_alive():
            process.kill()


class Client:
    """Somebody who stops the cell, in the driver's domain."""

    def __init__(self) -> None:
        os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
        import rclpy  # noqa: PLC0415
        from std_srvs.srv import Trigger  # noqa: PLC0415

        self._rclpy, self._kind = rclpy, Trigger
        rclpy.init()
        self.node = rclpy.create_node("stopper")
        self._clients = {name: self.node.create_client(Trigger, name) for name in ("estop", "estop_reset")}
        for client in self._clients.values():
            assert client.wait_for_service(timeout_sec=ANSWER_S)

    def call(self, name: str) -> bool:
        """Return whether a service answered in time."""
        future = self._clients[name].call_async(self._kind.Request())
        self._rclpy.spin_until_future_complete(self.node, future, timeout_sec=ANSWER_S)
        return bool(future.done() and future.exception() is None and future.result() is not None)

    def close(self) -> None:
        """Leave."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


def measure(client: Client, servos: Servos, count: int) -> tuple[list[float], int]:
    """Stop and reset so many times; return the times to torque off [s] and how many were not answered."""
    times, unanswered = [], 0
    for _ in range(count):
        if not servos.wait_for(3, ANSWER_S):
            client.call("estop_reset")
            if not servos.wait_for(3, ANSWER_S):
                raise SystemExit("the drives did not come back after estop_reset")
        began = time.monotonic()
        answered = client.call("estop")
        unanswered += not answered
        if servos.wait_for(0, ANSWER_S):
            times.append(max(0.0, servos.last_on_s - began))
        client.call("estop_reset")
    return times, unanswered


def _distribution(times: list[float]) -> str:
    median, p99 = statistics.median(times), sorted(times)[int(0.99 * (len(times) - 1))]
    return f"p50 {1e3 * median:.1f}, p99 {1e3 * p99:.1f}, max {1e3 * max(times):.1f} ms"


def main() -> None:
    """Measure under each load."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="stops under each load (default: %(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, emulated_servos(Path(name)) as servos:
        driver = start_driver(servos, Path(name), DOMAIN)
        client = Client()
        results: dict[str, list[float]] = {}
        unanswered = 0
        try:
            for label, flood in LOADS.items():
                with load(flood):
                    results[label], missing = measure(client, servos, options.count)
                    unanswered += missing
        finally:
            client.close()
            driver.terminate()
            driver.wait(10.0)
    note = "; ".join(f"{label}: {_distribution(times)}" for label, times in results.items())
    every = [value for times in results.values() for value in times]
    stops = len(every)
    claim(
        "effective max", 1e3 * max(every), "ms", better="lower", goal=1e3 * GOAL_S, runs=stops, note=note,
        peer="no load", peer_value=1e3 * max(results["no load"]),
    )  # fmt: skip
    claim("unanswered", float(unanswered), "1", better="lower", goal=0.0, runs=stops, note=f"of {stops} stops")


if __name__ == "__main__":
    main()
