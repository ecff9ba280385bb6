# SPDX-License-Identifier: Apache-2.0
"""Run a grasp policy in the live emulated cell, through tendon/trajectory, with the tendons leased."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_gym.grasp_policy import SHIPPED, GraspPolicy
from softgrip_gym.grasp_product import CLOSE_S, HOLD_S
from softgrip_gym.nodes.policy_runner import PolicyRunError, PolicyRunner


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0 held, 1 not held, 2 when there is no cell or no policy."""
    products = read_catalogue().products
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_gym run_policy",
        description=__doc__,
        epilog="A cell has to run, with the finger set of the policy mounted: `make cell`, or `ros2 launch "
        "softgrip_bringup cell.launch.yaml`. Exit code 0: held; 1: not held. See docs/virtual.md.",
    )
    parser.add_argument(
        "policy", nargs="?", type=Path, default=SHIPPED, help="file of `train`; default: the shipped one"
    )
    parser.add_argument("--product", default="apple", choices=list(products), metavar="NAME")
    parser.add_argument("--hold", type=float, default=HOLD_S, metavar="S", help="seconds after the closing")
    command_line = sys.argv if args is None else ["run_policy", *args]
    options = parser.parse_args(remove_ros_args(command_line)[1:])
    try:
        policy = GraspPolicy.load(options.policy)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    rclpy.init(args=command_line)
    node = Node("policy_runner")
    try:
        run = PolicyRunner(node, policy).grasp(products[options.product], CLOSE_S, options.hold)
    except PolicyRunError as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print(json.dumps(asdict(run)))
    return 0 if run.is_held else 1


if __name__ == "__main__":
    sys.exit(main())
