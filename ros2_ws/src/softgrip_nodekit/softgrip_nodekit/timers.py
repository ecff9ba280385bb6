# SPDX-License-Identifier: Apache-2.0
"""Timers that no simulated time stops: for whatever watches for silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node


def steady_timer(node: Node, period: float, callback: Callable[[], None], callback_group: Any = None) -> Any:
    """Return a timer on the steady clock.

    A timer of `Node.create_timer` follows the node's clock: with ``use_sim_time`` it stands while nobody publishes
    /clock, and a watch that stands finds nothing.

    Args:
        node: that runs it.
        period: [s].
        callback: what is called.
        callback_group: None = the node's default one.
    """
    return node.create_timer(
        period, callback, callback_group=callback_group, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
