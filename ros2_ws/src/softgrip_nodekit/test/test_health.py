# SPDX-License-Identifier: Apache-2.0
"""A node that stands still is named, and a watcher that stood still itself blames nobody."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from softgrip_nodekit import HealthMonitor, HealthWatch
from softgrip_nodekit.guards import serve_ping
from softgrip_testing.waiting import TEST_TIMEOUT_S, wait_until


def test_silence_counts_from_the_last_answer_and_is_told_once() -> None:
    watch = HealthWatch(["manager", "camera"], limit_s=1.0, max_gap_s=0.6)
    reported = []
    for tick in range(21):  # every half second
        now = 0.5 * tick
        if not 2.0 < now < 6.0:
            watch.take_answer("manager", now)
        change = watch.find_changes(now)
        reported += [(now, "silent", name) for name in change.silent] + [(now, "back", name) for name in change.back]
    assert reported == [(3.5, "silent", "manager"), (6.0, "back", "manager")]
    assert watch.silent == []


def test_a_node_that_was_never_there_is_not_missed() -> None:
    watch = HealthWatch(["manager"])
    assert [watch.find_changes(0.5 * tick).silent for tick in range(10)] == [[]] * 10


def test_a_watcher_that_stood_still_gives_all_their_time_again() -> None:
    watch = HealthWatch(["manager"], limit_s=1.0, max_gap_s=0.5)
    watch.take_answer("manager", 0.0)
    assert watch.find_changes(0.25).silent == []
    assert watch.find_changes(5.0).silent == []  # this process was frozen, not the manager
    assert [watch.find_changes(5.0 + 0.25 * tick).silent for tick in range(1, 6)] == [[], [], [], [], ["manager"]]


class Watched:
    """A node whose executor can be made to stand still."""

    def __init__(self, name: str, namespace: str) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node(name, context=self.context, namespace=namespace)
        serve_ping(self.node)
        self.go_on = threading.Event()
        self.go_on.set()
        self.node.create_timer(0.01, lambda: self.go_on.wait(TEST_TIMEOUT_S) and None)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def close(self) -> None:
        self.go_on.set()
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def watched() -> Iterator[Callable[..., Watched]]:
    made: list[Watched] = []

    def make(*arguments: str) -> Watched:
        made.append(Watched(*arguments))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def driver() -> Iterator[Node]:
    """A node that nobody spins: the monitor does not need its executor."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node("driver", context=context, namespace="cell")
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_a_frozen_executor_is_named_while_its_node_is_still_on_the_graph(
    driver: Node, watched: Callable[..., Watched]
) -> None:
    manager, other = watched("manager", "/cell"), watched("other", "/elsewhere")
    reported: list[tuple[str, str]] = []
    monitor = HealthMonitor(
        driver,
        ["manager", "/elsewhere/other"],
        period=0.02,
        limit=0.5,
        on_silent=lambda name: reported.append(("silent", name)),
        on_back=lambda name: reported.append(("back", name)),
    )
    try:
        wait_until(lambda: len(monitor._watch._answered) == 2)
        manager.go_on.clear()
        wait_until(lambda: reported == [("silent", "manager")])
        assert monitor.silent == ["manager"]
        assert "manager" in driver.get_node_names()
        manager.go_on.set()
        wait_until(lambda: reported == [("silent", "manager"), ("back", "manager")])
        other.close()  # ended, not frozen: it does not answer either
        wait_until(lambda: monitor.silent == ["/elsewhere/other"])
    finally:
        monitor.close()
