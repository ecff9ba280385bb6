# SPDX-License-Identifier: Apache-2.0
"""Which executor runs a node, and callbacks that want to know how a message came."""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterator
from importlib import metadata
from typing import Any

import pytest
import rclpy
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from softgrip_nodekit import executor as executor_module
from softgrip_nodekit import make_executor, with_message_info
from softgrip_nodekit.executor import _EVENTS_SINCE, _rclpy_version
from softgrip_nodekit.priority import Breather


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init()
    node = Node("executed")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_threads_and_guard_conditions_decide(node: Node) -> None:
    assert isinstance(make_executor(node, 3), MultiThreadedExecutor)
    node.create_guard_condition(lambda: None)
    assert isinstance(make_executor(node), SingleThreadedExecutor)


@pytest.mark.parametrize(
    ("version", "new_enough"),
    [("7.1.11", True), ("7.2.0", True), ("7.1.10", False), ("3.3.1", False), ("unknown", False)],
)
def test_the_version_of_rclpy_is_read(version: str, new_enough: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "version", lambda _: version)
    assert (_rclpy_version() >= _EVENTS_SINCE) is new_enough


def test_both_ways_of_handing_over_a_message_and_its_info() -> None:
    taken: list[tuple[Any, dict[str, Any]]] = []

    def on_message(message: Any, info: dict[str, Any]) -> None:
        taken.append((message, info))

    callback = with_message_info(on_message)
    callback(b"a", {"n": 1})
    callback((b"b", {"n": 2}))  # type: ignore[call-arg]
    assert taken == [(b"a", {"n": 1}), (b"b", {"n": 2})]
    with pytest.raises(TypeError):  # so does rclpy find out that it wants both
        inspect.signature(callback).bind(object())


def test_a_subscription_is_served_with_the_info_by_the_executor_made(node: Node) -> None:
    taken: list[tuple[str, int]] = []

    def on_message(message: String, info: dict[str, Any]) -> None:
        taken.append((message.data, info["source_timestamp"]))

    node.create_subscription(String, "said", with_message_info(on_message), 10)
    publisher = node.create_publisher(String, "said", 10)
    executor = make_executor(node)
    executor.add_node(node)
    deadline = time.monotonic() + 10.0
    before = time.time_ns()
    while not taken and time.monotonic() < deadline:
        publisher.publish(String(data="x"))
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()
    assert taken[0][0] == "x"
    assert before <= taken[0][1] <= time.time_ns()


@pytest.mark.parametrize("is_simulated", [False, True])
@pytest.mark.parametrize("threads", [1, 3])
def test_an_executor_takes_a_breath_between_callbacks_unless_its_time_is_simulated(
    node: Node, monkeypatch: pytest.MonkeyPatch, threads: int, is_simulated: bool
) -> None:
    """What a real-time one needs in a flood; it decides itself whether it does (`Breather`)."""
    taken: list[float] = []
    monkeypatch.setattr(Breather, "take_breath", lambda _: taken.append(time.monotonic()) is None)
    monkeypatch.setattr(executor_module, "is_simulated", lambda _: is_simulated)
    calls: list[int] = []
    node.create_timer(0.001, lambda: calls.append(1))
    node.create_guard_condition(lambda: None)  # which rclpy's events executor does not run
    executor = make_executor(node, threads)
    executor.add_node(node)
    end = time.monotonic() + 10.0
    while len(calls) < 20:
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    assert (len(taken) >= 20) != is_simulated
    assert not (is_simulated and taken)
