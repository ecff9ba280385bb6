# SPDX-License-Identifier: Apache-2.0
"""Orders that are older than they look: what lies in a node's queues when it goes on after it stood still.

A process that was stopped (SIGSTOP, a debugger), swapped out, suspended with its computer or kept by a disk finds
requests whose senders gave up long ago, and nothing in a request says how old it is. So for a while it obeys nothing
then that makes something move or the cell less safe.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from softgrip_nodekit.cell_time import steady_timer, time_waits_for

#: [s] An order that has waited for longer may have been given up by whoever sent it.
MAX_STANDSTILL_S = 2.0
#: [s] In this time what had been waiting is taken from the queues.
QUARANTINE_S = 1.0
#: [s] between looks
LOOK_PERIOD_S = 0.25


def boot_time_s() -> float:
    """Return a steady time that goes on while the computer is suspended [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Standstill:
    """Whether callbacks have just stood still, from the first look on. Any thread may look, the first one notices.

    Args:
        now_s: steady time [s]; None = `boot_time_s`.
    """

    def __init__(self, now_s: Callable[[], float] | None = None) -> None:
        self._now_s = now_s or boot_time_s
        self._lock = threading.Lock()
        self._looked: float | None = None
        self._until = -math.inf
        self._stood_s = 0.0

    def measure_gap(self) -> float:
        """Return for how long callbacks have stood still since the last look [s], 0 where they have not."""
        with self._lock:
            now = self._now_s()
            gap = 0.0 if self._looked is None else now - self._looked
            self._looked = now
            if gap <= MAX_STANDSTILL_S:
                return 0.0
            self._until, self._stood_s = now + QUARANTINE_S, gap
            return gap

    def refusal(self) -> str:
        """Return why an order that is taken now may be too old to be obeyed, empty when it is not."""
        if self._looked is None:
            return ""
        self.measure_gap()
        if self._now_s() >= self._until:
            return ""
        return (
            f"the node stood still for {self._stood_s:.1f} s, and this order may be as old; ask again in "
            f"{QUARANTINE_S:g} s"
        )


class OrderGuard:
    """Says of the orders that a node takes whether they may be too old.

    In an emulated cell time waits for the node, so nothing gets old meanwhile.

    Args:
        node: its callbacks take the orders; one more looks whether they go on.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._standstill = Standstill()
        steady_timer(node, LOOK_PERIOD_S, self._look, MutuallyExclusiveCallbackGroup())

    @property
    def refusal(self) -> str:
        """Why an order may be too old to be obeyed, empty when it is not."""
        return "" if time_waits_for(self._node) else self._standstill.refusal()

    def _look(self) -> None:
        stood_s = self._standstill.measure_gap()
        if stood_s and not time_waits_for(self._node):
            self._node.get_logger().warning(
                f"stood still for {stood_s:.1f} s; for {QUARANTINE_S:g} s orders are refused, which may be as old"
            )
