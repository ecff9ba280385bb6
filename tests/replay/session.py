# SPDX-License-Identifier: Apache-2.0
"""A client of the emulated cell that makes it do everything once.

A calibration, a closing with each finger set, and a grasp with each outcome. Run beside
`ros2 launch softgrip_bringup cell.launch.yaml`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.operator import CellOperator
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_interfaces.srv import InjectFault, StopRecording
from softgrip_nodekit import SENSOR

SLOTS = ("index", "middle", "thumb")
SETS = ("hook", "pinch", "power")
PRODUCT = "egg"
CABLE_RADIUS, SURFACE_RADIUS = 0.000125, 0.003  # [m]
TRIES = 4
PULL, SPEED = 0.020, 0.016  # [m], [m/s] of a closing


class Session:
    """The steps, in their order."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, hands: Hands) -> None:
        self._node = node
        self._link = CellLink(node, executor)
        self._hands = hands
        self._cell = CellController(node, wait=self._link.wait)
        self._operator = CellOperator(self._link, hands, self._cell, SLOTS)
        self._inject = node.create_client(InjectFault, "emulator/inject_fault")
        self._seen: list[TendonStatusArray] = []
        node.create_subscription(TendonStatusArray, "tendon/status", self._seen.append, SENSOR)

    def run(self) -> None:
        """Do everything once; each grasp has to end as it should."""
        self._link.until(lambda: bool(self._seen), 30.0, "tendon/status")
        self._operator.calibrate(CABLE_RADIUS, SURFACE_RADIUS)
        for finger_set in SETS:
            self._operator.swap(finger_set)
            self._operator.move(PULL, SPEED)
            self._operator.move(0.0, SPEED)
        self._grasp("GRIPPED", product=PRODUCT)
        self._grasp("EMPTY", product="")
        self._grasp("SLIPPED", product=PRODUCT, during=("lift", lambda: self._hands.place("")))
        self._expect("ABORTED", self._cell.grasp("nothing that the cell knows"))
        self._grasp("TENDON_FAULT", product=PRODUCT, during=("hold", self._break_a_tendon), release=False)
        self._cell.select(PRODUCT)  # answered after the last grasp's step was written into the manager's trace
        self._link.call(StopRecording, "recorder/stop", StopRecording.Request(), timeout=30.0)

    def _grasp(
        self,
        outcome: str,
        *,
        product: str,
        during: tuple[str, Callable[[], object]] | None = None,
        release: bool = True,
    ) -> None:
        def on_phase(phase: str) -> None:
            if during is not None and phase == during[0]:
                during[1]()

        # Worn-in fingers and a product out of a crate are not always good for it at once.
        for _ in range(TRIES):
            self._hands.place(product)
            result = self._cell.grasp(PRODUCT, trial=True, on_phase=on_phase)
            if release:
                self._cell.release()
            self._hands.place("")
            if GRASP_OUTCOMES[result.outcome] == outcome:
                break
        self._expect(outcome, result)

    def _break_a_tendon(self) -> None:
        self._inject.call_async(InjectFault.Request(fault="tendon_break", target="index"))

    def _expect(self, outcome: str, result: Any) -> None:
        found = GRASP_OUTCOMES[result.outcome]
        self._node.get_logger().info(f"{outcome}: {result.reason}")
        if found != outcome:
            raise RuntimeError(f"expected a grasp to end {outcome}, found {found}: {result.reason}")


def main() -> int:
    """Run the session; 0 when everything went as it should."""
    rclpy.init()
    node = Node("session")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    hands = Hands()
    try:
        Session(node, executor, hands).run()
    finally:
        hands.close()
        executor.shutdown(timeout_sec=2.0)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
