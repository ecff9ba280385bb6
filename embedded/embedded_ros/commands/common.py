# SPDX-License-Identifier: Apache-2.0
"""What the commands share: a look at the graph without a node, and a node for those that need one."""

from __future__ import annotations

import contextlib
import os
import signal
from typing import TYPE_CHECKING, Any

from embedded_ros import network
from embedded_ros.errors import WireError
from embedded_ros.graph import Graph

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from types import FrameType

    from rclpy.node import Node

SETTLE_S = 0.25


def domain() -> int:
    """Return ROS_DOMAIN_ID."""
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdigit() or int(text) > 232:
        raise WireError(f"ROS_DOMAIN_ID: expected a number 0..232, found {text!r}")
    return int(text)


@contextlib.contextmanager
def graph() -> Iterator[Graph]:
    """Open a session, look around, close."""
    session, _ = network.open_session(domain(), host=False)
    try:
        found = Graph()
        found.watch(session, domain())
        found.settle(SETTLE_S)
        yield found
    finally:
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub


def _terminate(number: int, _: FrameType | None) -> None:
    raise SystemExit(number)


@contextlib.contextmanager
def node(name: str, *, host: bool = False) -> Iterator[Node]:
    """Make a node without parameter services and log topic; shut down at the end."""
    import rclpy  # noqa: PLC0415  commands that only look at the graph start without it
    from rclpy.node import Node  # noqa: PLC0415  as above
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415  as above
    from rclpy.utilities import get_default_context  # noqa: PLC0415  as above

    get_default_context()._hosts_router = host
    # Whatever a command waits for, a signal ends it there and then.
    signal.signal(signal.SIGTERM, _terminate)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    made = Node(f"_ros2cli_{os.getpid()}_{name}", start_parameter_services=False, enable_rosout=False)
    made.context._graph.settle(SETTLE_S)
    try:
        yield made
    finally:
        made.destroy_node()
        rclpy.try_shutdown()


def hidden(name: str) -> bool:
    """Whether tools leave a name out."""
    return any(part.startswith("_") for part in name.split("/") if part)


def absolute(name: str) -> str:
    """Return a node's full name."""
    return name if name.startswith("/") else f"/{name}"


def add_hidden(parser: argparse.ArgumentParser) -> None:
    """Add the options that ros2cli has everywhere."""
    parser.add_argument("--include-hidden-nodes", "-a", action="store_true", help="consider hidden nodes as well")
    parser.add_argument("--spin-time", type=float, help="accepted for compatibility; the graph is known at once here")
    parser.add_argument("--no-daemon", action="store_true", help="accepted for compatibility; there is no daemon here")


def call(caller: Node, kind: Any, name: str, request: Any, timeout_s: float = 5.0) -> Any:
    """Call a service; return the response, or None when there is none in time."""
    import rclpy  # noqa: PLC0415  as above

    client = caller.create_client(kind, name)
    try:
        if not client.wait_for_service(timeout_s):
            return None
        future = client.call_async(request)
        rclpy.spin_until_future_complete(caller, future, timeout_sec=timeout_s)
        return future.result() if future.done() else None
    finally:
        caller.destroy_client(client)
