# SPDX-License-Identifier: Apache-2.0
"""Work through an order as the controller of a plant does; needs a running cell (`make cell` in another terminal).

python examples/cell_controller.py egg grape
"""

import sys

import rclpy
from rclpy.node import Node

from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController


def work(controller: CellController, products: list[str], confirm: object) -> dict[str, str]:
    """Grasp each product once, in the order with as few swaps as possible; returns product -> outcome."""
    outcomes = {}
    for step in controller.plan(products, [1] * len(products)).steps:
        choice = controller.select(step.product)
        if choice.swap_needed:
            swapped = controller.swap(choice.finger_set, confirm)
            if swapped.outcome != swapped.SUCCEEDED:
                raise SystemExit(f"swap to {choice.finger_set}: {swapped.reason}")
        result = controller.grasp(step.product, on_phase=lambda phase: print("  ", phase))
        outcomes[step.product] = GRASP_OUTCOMES[result.outcome]
        print(f"{step.product}: {outcomes[step.product]}: {result.reason}")
        controller.release()
    return outcomes


def ask(step: str, instruction: str) -> list[str]:
    """Ask the person at the cell; returns the serials that were typed in."""
    return input(f"{instruction}\n[{step}] Enter when done, or the serials: ").replace(",", " ").split()


if __name__ == "__main__":
    rclpy.init()
    work(CellController(Node("my_controller")), sys.argv[1:] or ["egg"], ask)
    rclpy.shutdown()
