# SPDX-License-Identifier: Apache-2.0
"""For tests of a node as a process: the process itself, and a peer that talks to it, in a domain of their own."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_testing.waiting import TEST_TIMEOUT_S

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile
    from rclpy.task import Future

T = TypeVar("T")

Start = Callable[..., "subprocess.Popen[str]"]


@contextmanager
def node_processes(module: str, parameters: Sequence[str] = ()) -> Iterator[Start]:
    """Give a function that starts the node of a module with parameters ("name:=value"); at the end all are killed.

    Args:
        module: its ``main`` is run.
        parameters: of every process.
    """
    running: list[subprocess.Popen[str]] = []
    command = [sys.executable, "-c", f"import sys; from {module} import main; sys.exit(main())", "--ros-args"]

    def start(*more: str) -> subprocess.Popen[str]:
        words = [word for parameter in (*parameters, *more) for word in ("-p", parameter)]
        running.append(subprocess.Popen([*command, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        return running[-1]

    try:
        yield start
    finally:
        for process in running:
            process.kill()
            process.communicate()


class Peer:
    """A node that asks others, and waits with a deadline.

    Args:
        name: of the node.
    """

    def __init__(self, name: str) -> None:
        rclpy.init()
        self.node: Node = rclpy.create_node(name)

    def close(self) -> None:
        """Leave."""
        self.node.destroy_node()
        rclpy.try_shutdown()

    def wait(self, future: Future[T]) -> T:
        """Return what a future becomes."""
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=TEST_TIMEOUT_S)
        assert future.done(), "no answer in time"
        return future.result()

    def call(self, kind: Any, name: str, **fields: object) -> Any:
        """Return a service's answer."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=TEST_TIMEOUT_S), name
        return self.wait(client.call_async(kind.Request(**fields)))

    def trigger(self, name: str) -> Trigger.Response:
        """Return the answer of a std_srvs/Trigger."""
        answer: Trigger.Response = self.call(Trigger, name)
        return answer

    def hear(self, kind: type[T], topic: str, qos: QoSProfile | int) -> list[T]:
        """Return a list that grows by every message of a topic."""
        heard: list[T] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def spin_until(self, condition: Callable[[], object]) -> None:
        """Take what comes until a condition holds."""
        end = time.monotonic() + TEST_TIMEOUT_S
        while not condition():
            assert time.monotonic() < end, "not in time"
            rclpy.spin_once(self.node, timeout_sec=0.05)


@contextmanager
def peer_node(name: str) -> Iterator[Peer]:
    """Give a peer, and take it away at the end."""
    peer = Peer(name)
    try:
        yield peer
    finally:
        peer.close()
