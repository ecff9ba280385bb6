# SPDX-License-Identifier: Apache-2.0
"""How much of a hold is left when a process of the cell is killed: driver, manager, middleware; by the truth.

A live cell with all of its processes, in real time. Driver and middleware are killed while each tendon of the closed
hand holds 8 N (by the driver's estimate), the manager while it holds a product that it has grasped itself. The lowest
true tension at an actuator from the kill until ten seconds later, by when what was killed is back, counts as a share of
that tendon's true tension at the kill. The peer is the same hold with nothing killed: strips and cables relax. The
middleware's process is the router that all sessions meet at; a process of the cell takes its place.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import rclpy
from _live_cell import CABLE_RADIUS_M, END_S, SLOTS, START_S, SURFACE_RADIUS_M, cell
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from embedded_ros.network import router_port
from softgrip_cell.nodes.controller_client import CellController
from softgrip_demo.errors import ShiftError
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.operator import CellOperator
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import EmulatorTruth, TendonStatusArray
from softgrip_nodekit import SENSOR
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.process_table import node_processes

DOMAIN = 217
HELD_N = 8.0
SPEED_M_PER_S = 0.02
SETTLED_S, WATCHED_S = 2.0, 10.0
PRODUCT = "orange"
HOST = "import time, rclpy; rclpy.init(); node = rclpy.create_node('router_host'); time.sleep(1e6)"


@contextmanager
def router() -> Iterator[subprocess.Popen[bytes]]:
    """Run a process that does nothing but host the router of the domain."""
    host = subprocess.Popen([sys.executable, "-c", HOST], env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})
    end = time.monotonic() + END_S
    while True:
        with suppress(OSError), socket.create_connection(("localhost", router_port(DOMAIN)), 1.0):
            break
        if time.monotonic() > end:
            raise SystemExit("expected a router within 30 s, found none")
        time.sleep(0.02)
    try:
        yield host
    finally:
        host.kill()
        host.wait()


class Bench:
    """A cell whose tendons hold, and what they truly do."""

    def __init__(self, launch: subprocess.Popen[bytes]) -> None:
        self._launch = launch
        # in the cell's time, which grasps and orders are stamped with
        self._node = Node("hold_benchmark", parameter_overrides=[Parameter("use_sim_time", value=True)])
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        self._link = CellLink(self._node, executor)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._hands = Hands()
        self._controller = CellController(self._node, wait=self._link.wait)
        self._operator = CellOperator(self._link, self._hands, self._controller, SLOTS)
        self._true_n: list[list[float]] = []
        self._status: list[TendonStatusArray] = []
        self._node.create_subscription(EmulatorTruth, "emulator/truth", self._on_truth, SENSOR)
        self._node.create_subscription(TendonStatusArray, "tendon/status", self._status.append, SENSOR)

    def close(self) -> None:
        """End the hands' own thread."""
        self._hands.close()

    def _on_truth(self, message: EmulatorTruth) -> None:
        self._true_n.append([finger.tension for finger in message.fingers])

    def set_up(self) -> None:
        """Measure the friction and mount a checked finger set, as a shift begins."""
        self._link.until(lambda: bool(self._status), START_S, "tendon/status", self._steady)
        self._operator.calibrate(CABLE_RADIUS_M, SURFACE_RADIUS_M)
        self._operator.swap("power")

    def process(self, node: str) -> int:
        """Return the process of a node, once it is there and has been for long enough to be killed again."""
        self._link.until(lambda: node in node_processes(self._launch.pid), START_S, node, self._steady)
        return node_processes(self._launch.pid)[node]

    def pull(self) -> None:
        """Let every tendon of the empty hand hold 8 N: what a product that slips out changes is no kill's doing."""
        self._reset()
        goal = MoveTendon.Goal(mode=MoveTendon.Goal.TENSION, targets=[HELD_N], speed=SPEED_M_PER_S, tendons=list(SLOTS))
        result = self._link.act(MoveTendon, "tendon/move", goal)
        if result.outcome != result.REACHED:
            raise SystemExit(f"tendon/move ended with {result.outcome}: {result.reason}")

    def grasp(self) -> None:
        """Let the manager hold a product."""
        self._reset()
        self._hands.place(PRODUCT)
        result = self._controller.grasp(PRODUCT, confirm_lift=False, trial=True)
        if result.outcome != result.GRIPPED:
            raise SystemExit(f"cell/grasp ended with {result.outcome}: {result.reason}")

    def _reset(self) -> None:
        """End a stop; a driver that has just been started may not answer yet."""
        self._link.until(self._is_reset, START_S, "estop_reset to succeed", self._steady)

    def _is_reset(self) -> bool:
        try:
            self._link.call(Trigger, "estop_reset", Trigger.Request(), 30.0)
        except ShiftError:
            return False
        else:
            return True

    def share_left(self, process: int | None) -> float:
        """Kill a process and return the lowest share of a tendon's tension that is left; None = kill nothing."""
        self._watch(SETTLED_S)
        held_n = self._true_n[-1]
        self._true_n.clear()
        if process is not None:
            os.kill(process, signal.SIGKILL)
        self._watch(WATCHED_S)
        if len(self._true_n) < WATCHED_S:
            raise SystemExit(f"expected the truth 30 times a second, found it {len(self._true_n)} times")
        return min(min(now / before for now, before in zip(row, held_n, strict=True)) for row in self._true_n)

    def _watch(self, duration_s: float) -> None:
        end = time.monotonic() + duration_s
        self._link.until(lambda: time.monotonic() > end, 2.0 * duration_s + 10.0, "time to pass", self._steady)

    def let_go(self) -> None:
        """Release, whoever holds."""
        self._reset()
        self._controller.release(30.0)
        self._hands.place("")


def main() -> None:
    """Hold, kill, look."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--rounds", type=int, default=3, help="kills of the driver; the others are killed once (default: %(default)s)"
    )
    rounds = parser.parse_args().rounds
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    shares: dict[str, list[float]] = defaultdict(list)
    with router() as first_router, cell(str(DOMAIN), "rig_time_scale:=20.0", "panel:=false") as launch:
        rclpy.init()
        bench = Bench(launch)
        try:
            bench.set_up()
            nothing = ("nothing", bench.pull, lambda: None)
            driver = ("driver", bench.pull, lambda: bench.process("tendon_driver"))
            # last: after it the manager wants its fingers checked again
            manager = ("manager", bench.grasp, lambda: bench.process("grasp_mix_manager"))
            for name, hold, victim in [
                ("middleware", bench.pull, lambda: first_router.pid),
                *rounds * [nothing, driver],
                manager,
            ]:
                hold()
                shares[name].append(bench.share_left(victim()))
                print(f"{name}: {100.0 * shares[name][-1]:.1f} %", file=sys.stderr)
                bench.let_go()
        finally:
            bench.close()
            rclpy.try_shutdown()
    alone = shares.pop("nothing")
    note = ", ".join(f"{name} {100.0 * min(found):.1f} % of {len(found)}" for name, found in shares.items())
    claim(
        "hold through kill -9",
        100.0 * min(map(min, shares.values())),
        "%",
        better="higher",
        goal=80.0,
        runs=sum(map(len, shares.values())),
        note=f"lowest share of the true tension: {note}",
        peer="the same hold, nothing killed",
        peer_value=100.0 * min(alone),
    )


if __name__ == "__main__":
    main()
