# SPDX-License-Identifier: Apache-2.0
"""A cell for tests of who commands tendons: each tendon is where it is commanded to be."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from softgrip_interfaces.srv import AcquireLease, ReleaseLease
from softgrip_nodekit import RELIABLE, SENSOR, to_time_message
from softgrip_time.units import NANOSECONDS

SLOTS = ("index", "middle", "thumb")


class FollowingCell(Node):
    """Follows tendon/trajectory at once; its own time passes 10 ms a tick.

    Args:
        services: types and names of those that it answers beside the leases.
        tick_s: [s] of the computer's time between two ticks.
        n_per_m: stiffness that makes tensions of lengths [N/m].

    Attributes:
        asked: names of the services that were called; orders: trajectories; lengths_m: (3,) where the tendons are.
        owner: who has the tendons, so that a lease is refused; empty = nobody.
        speaks: says its state.
    """

    def __init__(self, services: Sequence[tuple[Any, str]], tick_s: float, n_per_m: float = 0.0) -> None:
        super().__init__("following_cell")
        self.asked: list[str] = []
        self.orders: list[JointTrajectory] = []
        self.lengths_m = np.zeros(len(SLOTS))
        self.time_ns, self.speaks, self.owner = NANOSECONDS, True, ""
        self._n_per_m = n_per_m
        for kind, name in ((AcquireLease, "tendon/lease"), (ReleaseLease, "tendon/lease_release"), *services):
            self.create_service(kind, name, partial(self._answer, name))
        self.create_subscription(JointTrajectory, "tendon/trajectory", self._follow, RELIABLE)
        self._state = self.create_publisher(JointState, "tendon/state", SENSOR)
        self.create_timer(tick_s, self._tick)

    def answer_service(self, name: str, response: Any) -> Any:
        """Answer a service."""
        self.asked.append(name)
        response.success = not (self.owner and name == "tendon/lease")
        response.message = "" if response.success else f"owned by {self.owner}"
        if name == "tendon/lease":
            response.token = "token"  # noqa: S105  of a test
        return response

    def _answer(self, name: str, _request: object, response: Any) -> Any:
        return self.answer_service(name, response)

    def publish_more(self) -> None:
        """Publish what a test wants said in every tick, behind tendon/state."""

    def _follow(self, message: JointTrajectory) -> None:
        self.orders.append(message)
        self.lengths_m = np.array(message.points[0].positions)

    def _tick(self) -> None:
        if not self.speaks:
            return
        self.time_ns += 10_000_000
        state = JointState(name=list(SLOTS), position=self.lengths_m.tolist(), velocity=[0.0] * len(SLOTS))
        state.effort = (self._n_per_m * self.lengths_m).tolist()
        state.header.stamp = to_time_message(self.time_ns)
        self._state.publish(state)
        self.publish_more()


@contextmanager
def spun(node: Node) -> Iterator[SingleThreadedExecutor]:
    """Spin a node in a thread of its own, and end rclpy with it."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield executor
    finally:
        executor.shutdown()
        rclpy.try_shutdown()
        thread.join(5.0)
