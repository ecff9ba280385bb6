# SPDX-License-Identifier: Apache-2.0
"""A stop that stays: estop, then the driver ends in one of five ways and starts again; by the truth of the servos.

Counted are starts that come up latched with torque off, and never had torque in between.
"""

from __future__ import annotations

import argparse
import resource
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import rclpy
from _emulated_drives import Servos, emulated_servos, start_driver
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_interfaces.msg import SafetyState, TendonStatusArray
from softgrip_nodekit import LATCHED, SENSOR
from softgrip_testing.benchmark_claim import claim

DOMAIN = 215
COUNT = 100
WAIT_S = 30.0
CYCLE = (
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
)


class Cell:
    """Driver, servos and a client, for one stop after another."""

    def __init__(self, node: Node, servos: Servos, folder: Path) -> None:
        self._node, self._servos, self._folder = node, servos, folder
        self._seen: list[TendonStatusArray] = []
        self._states: list[SafetyState] = []
        node.create_subscription(TendonStatusArray, "tendon/status", self._seen.append, SENSOR)
        node.create_subscription(SafetyState, "safety/state", self._states.append, LATCHED)
        self.driver = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        """Start the driver and wait until it is active."""
        self._seen.clear()
        self.driver = start_driver(self._servos, self._folder, DOMAIN)
        self._until(lambda: bool(self._seen))
        return self.driver

    def _until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + WAIT_S
        while not condition():
            if time.monotonic() > end:
                raise SystemExit("the driver did not come up")
            rclpy.spin_once(self._node, timeout_sec=0.02)

    def call(self, kind: type, name: str, **fields: object) -> bool:
        """Return whether a service answered with success."""
        client = self._node.create_client(kind, name)
        if not client.wait_for_service(timeout_sec=WAIT_S):
            return False
        future = client.call_async(kind.Request(**fields))
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=WAIT_S)
        self._node.destroy_client(client)
        return bool(future.done() and future.result() and future.result().success)

    def stop_and_end(self, way: str) -> bool:
        """Stop, end the driver in a way, start it again; return whether it came up latched and without torque."""
        self.call(Trigger, "estop_reset")
        if not self._servos.wait_for(3, WAIT_S):
            raise SystemExit("no torque after estop_reset")
        if way == "full disk":
            # A file may not grow by a byte: what ENOSPC does to a write, for this one process.
            resource.prlimit(self.driver.pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        self.call(Trigger, "estop")
        self._servos.wait_for(0, WAIT_S)
        stopped_at = time.monotonic()
        self._seen.clear()
        if way == "lifecycle cycle":
            for transition in CYCLE:
                self.call(ChangeState, "tendon_driver/change_state", transition=Transition(id=transition))
            self._until(lambda: bool(self._seen))
        else:
            ends = signal.SIGTERM if way == "SIGTERM" else signal.SIGKILL
            self.driver.send_signal(ends)
            self.driver.wait(WAIT_S)
            self.start()
        self._until(lambda: bool(self._seen and self._states))
        for _ in range(20):
            rclpy.spin_once(self._node, timeout_sec=0.02)
        latched = self._seen[-1].estop and self._states[-1].estop
        return latched and self._servos.powered == 0 and self._servos.last_on_s < stopped_at


WAYS = ("kill -9", "SIGTERM", "lifecycle cycle", "full disk", "kill -9 of the process tree")


def main() -> None:
    """Stop and restart."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="restarts in all (default: %(default)s)")
    options = parser.parse_args()
    good: Counter[str] = Counter()
    done: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name, emulated_servos(Path(name)) as servos:
        rclpy.init(domain_id=DOMAIN)
        node = rclpy.create_node("restarts")
        cell = Cell(node, servos, Path(name))
        try:
            for number in range(options.count):
                way = WAYS[number % len(WAYS)]
                good[way] += cell.stop_and_end(way)
                done[way] += 1
        finally:
            cell.driver.kill()
            node.destroy_node()
            rclpy.try_shutdown()
    note = ", ".join(f"{way} {good[way]} of {done[way]}" for way in WAYS if done[way])
    share = 100.0 * good.total() / done.total()
    claim("latched restarts", share, "%", better="higher", goal=100.0, runs=done.total(), note=note)


if __name__ == "__main__":
    main()
