# SPDX-License-Identifier: Apache-2.0
"""A node says when the publisher of an input goes, and when it is back."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Int32

from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, Diagnostics, Health
from softgrip_nodekit.diagnostics import Presence, diagnosed_nodes


def test_a_first_appearance_is_no_news_and_every_change_is_told_once() -> None:
    reported: list[tuple[str, bool]] = []
    presence = Presence(lambda name, there: reported.append((name, there)))
    for names in (["a"], ["a", "b"], ["b"], ["b"], ["a", "b"], [], [], ["b"]):
        presence.update(names)
    assert reported == [("a", False), ("a", True), ("a", False), ("b", False), ("b", True)]


def test_a_publisher_whose_node_is_not_known_yet_is_no_node() -> None:
    """As Fast DDS and Cyclone DDS tell of it for a moment (rmw_dds_common's test_graph_cache.cpp has these names)."""
    names = (("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_"), ("/cell", "camera"), ("/", "tracker"))
    publishers = [SimpleNamespace(node_namespace=namespace, node_name=name) for namespace, name in names]
    node = SimpleNamespace(get_publishers_info_by_topic=lambda _: publishers, get_namespace=lambda: "/")
    assert diagnosed_nodes(cast("Any", node)) == ["/cell/camera", "/tracker"]


@pytest.fixture
def executor() -> Iterator[SingleThreadedExecutor]:
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    executor = SingleThreadedExecutor(context=context)
    yield executor
    executor.shutdown()
    context.try_shutdown()


def make_node(executor: SingleThreadedExecutor, name: str) -> Any:
    node = rclpy.create_node(name, context=executor.context)
    executor.add_node(node)
    return node


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        executor.spin_once(timeout_sec=0.05)


def test_diagnostics_tell_of_streams_states_and_nodes_that_are_gone_but_not_of_commands(
    executor: SingleThreadedExecutor,
) -> None:
    reports: dict[str, tuple[bytes, str]] = {}
    watcher = make_node(executor, "watcher")
    for topic, qos in (("stream", SENSOR), ("state", LATCHED), ("command", RELIABLE)):
        watcher.create_subscription(Int32, topic, lambda _: None, qos)

    def on_diagnostics(message: DiagnosticArray) -> None:
        reports.update({status.name: (status.level, status.message) for status in message.status})

    watcher.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, RELIABLE)
    diagnostics = Diagnostics(watcher, watch_nodes=True)
    diagnostics.set("itself", Health.OK, "fine")

    def start_source() -> Any:
        source = make_node(executor, "source")
        for topic, qos in (("stream", SENSOR), ("state", LATCHED), ("command", RELIABLE)):
            source.create_publisher(Int32, topic, qos)
        Diagnostics(source).set("itself", Health.OK, "fine")
        return source

    source = start_source()
    spin_until(executor, lambda: "source: itself" in reports)
    began = watcher.get_clock().now()
    spin_until(executor, lambda: (watcher.get_clock().now() - began).nanoseconds > 5e8)
    assert not [name for name in reports if "input" in name or "node" in name]

    source.destroy_node()
    expected = {"watcher: input /stream", "watcher: input /state", "watcher: node /source"}
    spin_until(executor, lambda: expected <= reports.keys())
    assert all(reports[name][0] == DiagnosticStatus.WARN for name in expected)
    assert "watcher: input /command" not in reports

    start_source()
    spin_until(executor, lambda: all(reports[name][0] == DiagnosticStatus.OK for name in expected))


def test_components_may_be_set_by_one_thread_while_another_publishes(executor: SingleThreadedExecutor) -> None:
    node = make_node(executor, "busy")
    diagnostics = Diagnostics(node)
    for number in range(200):
        diagnostics.set(f"first {number}", Health.OK, "")
    stop = threading.Event()

    def extend() -> None:
        for number in itertools.count():
            if stop.is_set():
                return
            diagnostics._components[f"later {number % 500}"] = (Health.OK, "", {})
            diagnostics._components.pop(f"later {(number + 250) % 500}", None)

    # As `set` does from the drives' thread, only more often than any node: what is published must be a copy.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    extending = threading.Thread(target=extend)
    extending.start()
    try:
        for _ in range(50):
            diagnostics.publish()
    finally:
        stop.set()
        extending.join()
        sys.setswitchinterval(interval)
