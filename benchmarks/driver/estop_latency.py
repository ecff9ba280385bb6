# SPDX-License-Identifier: Apache-2.0
"""From a client's estop to torque off, by the truth of the emulated servos, beside strangers who flood the driver.

Each load runs in a process of its own: messages of 100 MB on tendon/trajectory, malformed requests to estop,
estop_reset and tendon/lock, a thousand moves one after another, a grasp_mix_manager that is frozen (SIGSTOP). The peer
is the same without any load, in the same run. A load that ends or sends nothing ends the benchmark; how much of it was
sent a second stands in the note. ``--json`` keeps each single time, so that runs may be put together.
"""

from __future__ import annotations

import argparse
import json
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

import zenoh
from _emulated_drives import Servos, emulated_servos, start_driver

from softgrip_testing.benchmark_claim import claim

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "cell"))
from _hostile import Stranger

DOMAIN = 214
COUNT = 200
ANSWER_S = 30.0
#: [s] for a load to begin on a computer that others keep busy
START_S = 120.0
#: [s] for the drives to have torque after a reset, and how often it is asked for
RESET_S, MAX_RESETS = 10.0, 12
BIG_BYTES = 100_000_000
#: [1/s]
MALFORMED_RATE = 10_000.0
GOAL_S = 0.050


def _flood_big(domain: int, stop: Any, sent: Any) -> None:
    """Send 100 MB as one trajectory, again and again."""
    stranger = Stranger(domain)
    key = next(target.key for target in stranger.targets() if target.name == "/tendon/trajectory")
    payload = bytes(BIG_BYTES)
    while not stop.is_set():
        stranger.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        sent.value += 1
        time.sleep(0.05)
    stranger.close()


def _flood_malformed(domain: int, stop: Any, sent: Any) -> None:
    """Send requests that are none, at a rate, without waiting for answers."""
    stranger = Stranger(domain)
    keys = [t.key for t in stranger.targets() if t.name in {"/estop", "/estop_reset", "/tendon/lock"}]
    began = time.monotonic()
    while not stop.is_set():
        key = keys[sent.value % len(keys)]
        stranger.session.get(key, lambda _reply: None, payload=b"\x00\x01nonsense", timeout=1.0)
        sent.value += 1
        ahead = sent.value / MALFORMED_RATE - (time.monotonic() - began)
        if ahead > 0.001:
            time.sleep(ahead)
    stranger.close()


def _flood_goals(domain: int, stop: Any, sent: Any) -> None:
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
    while not stop.is_set():
        client.send_goal_async(goal)
        sent.value += 1
        rclpy.spin_once(node, timeout_sec=0.0005)
    node.destroy_node()
    rclpy.try_shutdown()


def _freeze_manager(domain: int, stop: Any, sent: Any) -> None:
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
            sent.value = 1
            stop.wait()
        finally:
            manager.kill()
            manager.wait(ANSWER_S)
    node.destroy_node()
    rclpy.try_shutdown()


LOADS: dict[str, Callable[[int, Any, Any], None] | None] = {
    "no load": None,
    "100 MB messages": _flood_big,
    "malformed requests": _flood_malformed,
    "1,000 goals": _flood_goals,
    "frozen manager": _freeze_manager,
}


@contextmanager
def load(flood: Callable[[int, Any, Any], None] | None, per_s: list[float] | None = None) -> Iterator[None]:
    """Run a flood in a process of its own; ``per_s`` is given how much it sent a second.

    Raises:
        SystemExit: it sent nothing, or ended before it was told to.
    """
    if flood is None:
        yield
        return
    spawn = multiprocessing.get_context("spawn")
    stop, sent = spawn.Event(), spawn.Value("L", 0)
    process = spawn.Process(target=flood, args=(DOMAIN, stop, sent), daemon=True)
    process.start()
    end = time.monotonic() + START_S
    while sent.value == 0 and process.is_alive() and time.monotonic() < end:
        time.sleep(0.01)
    before, began = sent.value, time.monotonic()
    try:
        if not before:
            raise SystemExit(f"{flood.__name__} sent nothing")
        yield
        if not process.is_alive():
            raise SystemExit(f"{flood.__name__} ended with {process.exitcode} after {sent.value} messages")
        if per_s is not None:
            per_s.append((sent.value - before) / (time.monotonic() - began))
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
            assert client.wait_for_service(timeout_sec=START_S)

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
        _reset_until_powered(client, servos)
        began = time.monotonic()
        answered = client.call("estop")
        unanswered += not answered
        if servos.wait_for(0, ANSWER_S):
            times.append(max(0.0, servos.last_on_s - began))
        client.call("estop_reset")
    return times, unanswered


def _reset_until_powered(client: Client, servos: Servos) -> None:
    """Have all drives powered: one that did not answer at a reset, on a busy computer, wants another one."""
    for _ in range(MAX_RESETS):
        if servos.wait_for(3, RESET_S):
            return
        client.call("estop_reset")
    raise SystemExit(f"the drives did not come back after {MAX_RESETS} calls of estop_reset")


def _distribution(times: list[float]) -> str:
    median, p99 = statistics.median(times), sorted(times)[int(0.99 * (len(times) - 1))]
    return f"p50 {1e3 * median:.1f}, p99 {1e3 * p99:.1f}, max {1e3 * max(times):.1f} ms"


def main() -> None:
    """Measure under each load."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="stops under each load (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="file that is given a line with every time [s] for each load")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, emulated_servos(Path(name)) as servos:
        driver = start_driver(servos, Path(name), DOMAIN)
        client: Client | None = None
        results: dict[str, list[float]] = {}
        rates: dict[str, list[float]] = {label: [] for label in LOADS}
        unanswered = 0
        try:
            client = Client()
            for label, flood in LOADS.items():
                with load(flood, rates[label]):
                    results[label], missing = measure(client, servos, options.count)
                    unanswered += missing
                if options.json:
                    row = {"load": label, "times_s": results[label], "unanswered": missing, "per_s": rates[label]}
                    with options.json.open("a") as file:
                        file.write(json.dumps(row) + "\n")
        finally:
            if client is not None:
                client.close()
            driver.terminate()
            driver.wait(10.0)
    note = "; ".join(f"{label}{_rate(rates[label])}: {_distribution(times)}" for label, times in results.items())
    every = [value for times in results.values() for value in times]
    stops = options.count * len(LOADS)
    claim(
        "effective max", 1e3 * max(every), "ms", better="lower", goal=1e3 * GOAL_S, runs=len(every), note=note,
        peer="no load", peer_value=1e3 * max(results["no load"]),
    )  # fmt: skip
    never = stops - len(every)
    claim(
        "unanswered", float(unanswered + never), "1", better="lower", goal=0.0, runs=stops,
        note=f"of {stops} stops; {never} without effect",
    )  # fmt: skip


def _rate(per_s: list[float]) -> str:
    return f" ({per_s[0]:.0f}/s)" if per_s and per_s[0] >= 0.5 else ""


if __name__ == "__main__":
    main()
