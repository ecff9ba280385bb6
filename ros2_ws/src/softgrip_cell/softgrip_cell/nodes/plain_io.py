# SPDX-License-Identifier: Apache-2.0
"""Ways out of a node that nobody replays: the part of NodeIo that clients of the driver use, without a trace."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.action import ActionClient
from rclpy.node import Node

from softgrip_nodekit import Caller, Commander, SentGoal


class DriverIo(Protocol):
    """What a client of the driver needs of its node; `softgrip_nodekit.NodeIo` has it too."""

    def now_ns(self) -> int:
        """Return the node's clock [ns since the epoch]."""

    def monotonic_s(self) -> float:
        """Return the monotonic clock [s]."""

    def client(self, kind: Any, name: str) -> Caller:
        """Return a client of a service."""

    def action_client(self, kind: Any, name: str) -> Commander:
        """Return a client of an action."""


class PlainIo:
    """Clients and clocks of a node.

    Args:
        node: their owner; it has to be in a single-threaded executor.
    """

    def __init__(self, node: Node) -> None:
        self._node = node

    def now_ns(self) -> int:
        """Return the node's clock [ns since the epoch]."""
        return int(self._node.get_clock().now().nanoseconds)

    def monotonic_s(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def client(self, kind: Any, name: str) -> Caller:
        """Make a client of a service."""
        return _PlainCaller(self._node.create_client(kind, name))

    def action_client(self, kind: Any, name: str) -> Commander:
        """Make a client of an action."""
        return _PlainCommander(ActionClient(self._node, kind, name))

    def later(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Run work through the executor; at once when there is none."""
        executor = self._node.executor
        if executor is None:
            work(*arguments)
        else:
            executor.create_task(work, *arguments)


class _PlainCaller:
    def __init__(self, client: Any) -> None:
        self._client = client

    def ready(self) -> bool:
        return bool(self._client.service_is_ready())

    def call(self, request: Any, answered: Callable[[Any], None]) -> None:
        self._client.call_async(request).add_done_callback(lambda future: answered(future.result()))


class _PlainCommander:
    def __init__(self, client: Any) -> None:
        self._client = client

    def ready(self) -> bool:
        return bool(self._client.server_is_ready())

    def send(self, goal: Any, answered: Callable[[SentGoal], None]) -> None:
        future = self._client.send_goal_async(goal)
        future.add_done_callback(lambda done: answered(_PlainSentGoal(done.result())))


class _PlainSentGoal:
    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self.accepted = bool(handle.accepted)

    def cancel(self) -> None:
        self._handle.cancel_goal_async()

    def when_done(self, ended: Callable[[Any], None]) -> None:
        self._handle.get_result_async().add_done_callback(lambda future: ended(future.result().result))
