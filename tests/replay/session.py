# SPDX-License-Identifier: Apache-2.0
"""A client of the emulated cell that makes it do everything once.

A calibration, a closing with each finger set, and a grasp with each outcome. Run beside
`ros2 launch softgrip_bringup cell.launch.yaml`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.products import serials_of
from softgrip_interfaces.action import CalibrateFriction, MoveTendon
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_interfaces.srv import InjectFault, StopRecording
from softgrip_nodekit import SENSOR

SLOTS = ("index", "middle", "thumb")
SETS = ("hook", "pinch", "power")
PRODUCT = "egg"
COPIES = 2
CALIBRATIONS = 3  # tries
CABLE_RADIUS, SURFACE_RADIUS = 0.000125, 0.003  # [m]
PULL, SPEED = 0.020, 0.016  # [m], [m/s] of a closing


class Session:
    """The steps, in their order."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, hands: Hands) -> None:
        self._node = node
        self._link = CellLink(node, executor)
        self._hands = hands
        self._cell = CellController(node, wait=self._link.wait)
        self._confirm_rig = node.create_client(Trigger, "rig/confirm")
        self._inject = node.create_client(InjectFault, "emulator/inject_fault")
        self._seen: list[TendonStatusArray] = []
        node.create_subscription(TendonStatusArray, "tendon/status", self._seen.append, SENSOR)

    def run(self) -> None:
        """Do everything once; each grasp has to end as it should."""
        self._link.until(lambda: bool(self._seen), 30.0, "tendon/status")
        self._calibrate()
        for finger_set in SETS:
            self._swap(finger_set)
            self._move(PULL)
            self._move(0.0)
        self._grasp("GRIPPED", product=PRODUCT)
        self._grasp("EMPTY", product="")
        self._grasp("SLIPPED", product=PRODUCT, during=("lift", lambda: self._hands.place("")))
        self._expect("ABORTED", self._cell.grasp("nothing that the cell knows"))
        self._grasp("TENDON_FAULT", product=PRODUCT, during=("hold", self._break_a_tendon), release=False)
        self._link.call(StopRecording, "recorder/stop", StopRecording.Request(), timeout=30.0)

    def _calibrate(self) -> None:
        def on_feedback(feedback: Any) -> None:
            if feedback.phase == feedback.SET_UP:
                self._hands.set_rig(feedback.angle, feedback.load)
                self._confirm_rig.call_async(Trigger.Request())

        goal = CalibrateFriction.Goal(
            plan="9",
            law="matte",
            cable="PE braid 0.25 mm",
            surface="TPU, printed along the layers",
            cable_radius=CABLE_RADIUS,
            surface_radius=SURFACE_RADIUS,
            activate=True,
        )
        reasons = []
        for _ in range(CALIBRATIONS):
            result = self._link.act(CalibrateFriction, "rig/calibrate", goal, feedback=on_feedback, timeout=120.0)
            if result.outcome == result.SUCCEEDED:
                return
            reasons.append(result.reason)
        raise RuntimeError(f"the calibration failed: {'; '.join(reasons)}")

    def _swap(self, finger_set: str) -> None:
        reasons = []
        for copy in range(COPIES):
            serials = serials_of(finger_set, SLOTS, copy)
            result = self._cell.swap(finger_set, self._seat(finger_set, serials), serials)
            if result.outcome == result.SUCCEEDED:
                return
            reasons.append(result.reason)
        raise RuntimeError(f"no {finger_set} fingers passed: {'; '.join(reasons)}")

    def _seat(self, finger_set: str, serials: Sequence[str]) -> Callable[[str, str], Sequence[str]]:
        def confirm(step: str, _: str) -> Sequence[str]:
            if step == "remove":
                self._hands.mount(SLOTS, [""] * len(SLOTS), "")
            if step == "insert":
                self._hands.mount(SLOTS, serials, finger_set)
                return serials
            return ()

        return confirm

    def _move(self, pulled_length: float) -> None:
        goal = MoveTendon.Goal(mode=MoveTendon.Goal.LENGTH, targets=[pulled_length], speed=SPEED)
        self._link.act(MoveTendon, "tendon/move", goal, timeout=30.0)

    def _grasp(
        self,
        outcome: str,
        *,
        product: str,
        during: tuple[str, Callable[[], object]] | None = None,
        release: bool = True,
    ) -> None:
        self._hands.place(product)

        def on_phase(phase: str) -> None:
            if during is not None and phase == during[0]:
                during[1]()

        self._expect(outcome, self._cell.grasp(PRODUCT, trial=True, on_phase=on_phase))
        if release:
            self._cell.release()
        self._hands.place("")

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
