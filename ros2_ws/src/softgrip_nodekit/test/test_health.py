# SPDX-License-Identifier: Apache-2.0
"""A node that stands still is named, and a watcher that stood still itself blames nobody."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

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


def test_one_that_does_not_answer_for_a_second_is_silent() -> None:
    watch = HealthWatch(["manager"], max_gap_s=10.0)
    watch.take_answer("manager", 0.0)
    assert watch.find_changes(1.0).silent == []
    assert watch.find_changes(1.01).silent == ["manager"]


def test_who_was_silent_before_the_watcher_stood_still_is_silent_after_it() -> None:
    watch = HealthWatch(["manager"], limit_s=1.0, max_gap_s=1.5)
    watch.take_answer("manager", 0.0)
    assert watch.find_changes(1.2).silent == ["manager"]
    assert watch.find_changes(100.0) == ([], [])
    assert watch.silent == ["manager"]


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

    def drop(self) -> None:
        """End as a killed process does: what it was asked is never answered."""
        self.context.try_shutdown()
        self.go_on.set()
        self._thread.join()

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
        wait_until(lambda: len(monitor._asked._watch._answered) == 2)
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


@pytest.fixture
def monitor(driver: Node) -> Iterator[Callable[..., HealthMonitor]]:
    """Makes a monitor of /cell/manager that writes down what it says, and closes it."""
    made: list[HealthMonitor] = []

    def make(reported: list[tuple[str, str]], **options: Any) -> HealthMonitor:
        made.append(
            HealthMonitor(
                driver,
                ["manager"],
                period=0.02,
                on_silent=lambda name: reported.append(("silent", name)),
                on_back=lambda name: reported.append(("back", name)),
                **options,
            )
        )
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_a_monitor_that_stood_still_blames_nobody(
    monitor: Callable[..., HealthMonitor], watched: Callable[..., Watched]
) -> None:
    watched("manager", "/cell")
    reported: list[tuple[str, str]] = []
    stood_s = 0.0
    read_at: list[float] = []

    def now_s() -> float:
        read_at.append(stood_s)
        return time.monotonic() + stood_s

    watching = monitor(reported, limit=30.0, now_s=now_s)
    wait_until(lambda: bool(watching._asked._watch._answered))
    stood_s = 3600.0
    wait_until(lambda: read_at.count(stood_s) > 20)
    assert reported == []


def test_a_node_that_stands_still_is_asked_once_in_its_time(
    monitor: Callable[..., HealthMonitor], watched: Callable[..., Watched]
) -> None:
    manager = watched("manager", "/cell")
    reported: list[tuple[str, str]] = []
    read_at: list[float] = []

    def now_s() -> float:
        read_at.append(time.monotonic())
        return read_at[-1]

    watching = monitor(reported, limit=60.0, now_s=now_s)
    wait_until(lambda: bool(watching._asked._watch._answered))
    asked: list[Any] = []
    client = watching._asked._clients["manager"]
    ask = client.call_async
    manager.go_on.clear()
    client.call_async = lambda request: (asked.append(request), ask(request))[1]
    seen = len(read_at)
    wait_until(lambda: len(read_at) > seen + 50)
    manager.go_on.set()
    assert len(asked) <= 2, "what was asked before it stood still, and once more"


def test_who_comes_back_as_another_process_is_heard_though_a_ping_was_lost(
    monitor: Callable[..., HealthMonitor], watched: Callable[..., Watched]
) -> None:
    reported: list[tuple[str, str]] = []
    watching = monitor(reported, limit=0.3)
    first = watched("manager", "/cell")
    wait_until(lambda: bool(watching._asked._watch._answered))
    first.go_on.clear()
    wait_until(lambda: watching.silent == ["manager"])
    first.drop()
    watched("manager", "/cell")
    wait_until(lambda: watching.silent == [])
    assert reported[-1] == ("back", "manager")


def test_a_ping_that_failed_is_no_answer(monitor: Callable[..., HealthMonitor]) -> None:
    watching = monitor([])
    failed: Future[Any] = Future()
    failed.set_exception(RuntimeError("cannot be decoded"))
    watching._asked._take_answer("manager", failed)
    assert watching._asked._watch._answered == {}
    given: Future[Any] = Future()
    given.set_result(Trigger.Response())
    watching._asked._take_answer("manager", given)
    assert list(watching._asked._watch._answered) == ["manager"]


def test_a_ping_is_answered_with_success(driver: Node) -> None:
    serve_ping(driver)
    (ping,) = [service for service in driver.services if service.srv_name.endswith("/ping")]
    assert ping.callback(Trigger.Request(), Trigger.Response()).success
