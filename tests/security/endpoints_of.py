# SPDX-License-Identifier: Apache-2.0
"""Try to make every endpoint of a list with the keys in the environment; prints which the middleware let it make.

endpoints_of.py NODE FILE      FILE: {"publish": [TOPIC ...], "subscribe": [...], "serve": [SERVICE ...], ...}
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

#: Permissions name topics and services, not their types: one type stands for all.
MAKERS: dict[str, Callable[[Node, str], Any]] = {
    "publish": lambda node, name: node.destroy_publisher(node.create_publisher(Empty, name, 1)),
    "subscribe": lambda node, name: node.destroy_subscription(node.create_subscription(Empty, name, lambda _: None, 1)),
    "serve": lambda node, name: node.destroy_service(node.create_service(Trigger, name, lambda _, response: response)),
    "call": lambda node, name: node.destroy_client(node.create_client(Trigger, name)),
}


def is_made(make: Callable[[Node, str], Any], node: Node, name: str) -> bool:
    try:
        make(node, name)
    except Exception:  # noqa: BLE001  RCLError, RMWError or InvalidHandle, by kind and version
        return False
    return True


def main() -> int:
    names = json.loads(Path(sys.argv[2]).read_text())
    rclpy.init()
    # the node itself makes its parameter services here, and what else every node has
    node = rclpy.create_node(sys.argv[1])
    made = {grant: [one for one in names[grant] if is_made(make, node, one)] for grant, make in MAKERS.items()}
    node.destroy_node()
    rclpy.shutdown()
    sys.stdout.write(f"{json.dumps(made)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
