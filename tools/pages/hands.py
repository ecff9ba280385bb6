# SPDX-License-Identifier: Apache-2.0
"""What a person does at the emulated cell that the pages' commands are typed beside, for tools/pages/blocks.py.

python tools/pages/hands.py measure         friction on the rig: nine points
python tools/pages/hands.py swap pinch      a finger set, with its check; nothing where it is in already
python tools/pages/hands.py leave pinch     end a swap while hands are inside; prints its token
python tools/pages/hands.py rig 45 500      the wrap angle [deg] and the weight [g] of the rig
python tools/pages/hands.py mount pinch     fingers into the slots, as a step of a swap asks for
python tools/pages/hands.py place egg       a product between the fingers; without a name it is taken away
python tools/pages/hands.py home            the tendons, which a fault may have left without a zero
python tools/pages/hands.py release         what the hand holds, whoever closed it
python tools/pages/hands.py wait            until the cell is idle
python tools/pages/hands.py reset           an emergency stop, once it is pressed
"""

from __future__ import annotations

import argparse
import sys
from math import radians

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_cell.nodes.controller_client import CellController
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.operator import CellOperator
from softgrip_demo.products import serials_of
from softgrip_interfaces.action import SwapFingers
from softgrip_interfaces.msg import CellState, MountedFinger
from softgrip_interfaces.srv import ConfirmStep
from softgrip_nodekit import LATCHED, make_executor

SLOTS = ("index", "middle", "thumb")
CABLE_RADIUS_M, SURFACE_RADIUS_M = 0.125e-3, 3e-3
ANSWER_S = 180.0


class Person:
    """Who stands at the cell."""

    def __init__(self, node: Node) -> None:
        executor = make_executor(node)
        executor.add_node(node)
        self._link = CellLink(node, executor)
        self._hands = Hands(node.get_namespace())
        self._cell = CellController(node, wait=self._link.wait)
        self._operator = CellOperator(self._link, self._hands, self._cell, SLOTS)
        self._states: list[CellState] = []
        node.create_subscription(CellState, "cell/state", self._states.append, LATCHED)
        self._link.until(lambda: bool(self._states), ANSWER_S, "cell/state")

    def measure(self) -> None:
        """Measure friction, which makes a model that is young enough to grasp with."""
        self._operator.calibrate(CABLE_RADIUS_M, SURFACE_RADIUS_M)

    def swap(self, finger_set: str) -> None:
        """Swap fingers where the cell has not these, checked."""
        state = self._states[-1]
        if state.finger_set != finger_set or any(one.state != MountedFinger.VERIFIED for one in state.mounted):
            self._operator.swap(finger_set)

    def leave(self, finger_set: str) -> None:
        """Begin a swap, open the palm, and cancel: the drives stay locked."""
        feedback: list[SwapFingers.Feedback] = []
        client = ActionClient(self._link.node, SwapFingers, "cell/swap")
        self._link.until(client.server_is_ready, ANSWER_S, "cell/swap")
        goal = client.send_goal_async(
            SwapFingers.Goal(finger_set=finger_set), feedback_callback=lambda message: feedback.append(message.feedback)
        )
        handle = self._link.wait(goal, ANSWER_S, "cell/swap to take a goal")
        self._link.until(lambda: bool(feedback) and feedback[-1].confirmation, ANSWER_S, "a step to confirm")
        request = ConfirmStep.Request(step=feedback[-1].step, token=feedback[-1].token)
        self._link.call(ConfirmStep, "cell/confirm_step", request)
        self._link.wait(handle.cancel_goal_async(), ANSWER_S, "the swap to end")
        self._link.wait(handle.get_result_async(), ANSWER_S, "the swap's result")
        print(f"token: {feedback[-1].token}")

    def rig(self, angle_deg: str, load_g: str) -> None:
        """Set the rig."""
        self._hands.set_rig(radians(float(angle_deg)), float(load_g) / 1e3)

    def mount(self, finger_set: str) -> None:
        """Put the first prints of a set into the slots."""
        self._hands.mount(SLOTS, serials_of(finger_set, SLOTS), finger_set)

    def place(self, product: str = "") -> None:
        """Put a product between the fingers; none takes it away."""
        self._hands.place(product)

    def home(self) -> None:
        """Home the tendons."""
        self._link.call(Trigger, "tendon/home", Trigger.Request(), timeout=ANSWER_S)

    def release(self) -> None:
        """Let go."""
        self._link.call(Trigger, "tendon/release", Trigger.Request(), timeout=ANSWER_S)

    def wait(self) -> None:
        """Wait until the cell is idle."""
        self._link.until(lambda: self._states[-1].mode == CellState.IDLE, ANSWER_S, "a cell that is idle")

    def reset(self) -> None:
        """Reset the stop and wait until the cell says so."""
        self._link.call(Trigger, "estop_reset", Trigger.Request(), timeout=ANSWER_S)
        self._link.until(lambda: self._states[-1].mode != CellState.ESTOP, ANSWER_S, "a cell that is not stopped")

    def close(self) -> None:
        """End the hands' thread."""
        self._hands.close()


def main() -> int:
    """Do what the line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "act", choices=["measure", "swap", "leave", "rig", "mount", "place", "home", "release", "wait", "reset"]
    )
    parser.add_argument("words", nargs="*")
    parser.add_argument("--cell", default="", metavar="NAME", help="of the cell, where it has one")
    arguments = parser.parse_args()
    rclpy.init()
    person = Person(Node("person", namespace=arguments.cell))
    try:
        getattr(person, arguments.act)(*arguments.words)
    finally:
        person.close()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
