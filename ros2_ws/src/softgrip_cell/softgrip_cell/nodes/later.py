# SPDX-License-Identifier: Apache-2.0
"""Doing something after the present callback is over."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node


def later(node: Node, work: Callable[..., Any], *arguments: Any) -> None:
    """Run work in the node's executor once the present callback has returned; at once when the node has none."""
    executor = node.executor
    if executor is None:
        work(*arguments)
    else:
        executor.create_task(work, *arguments)
