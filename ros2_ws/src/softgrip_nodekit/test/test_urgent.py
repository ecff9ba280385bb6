# SPDX-License-Identifier: Apache-2.0
"""A service with a session, queue and thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from softgrip_nodekit import UrgentServer, isolated, standstill, urgent
from softgrip_nodekit.callback_errors import callback_errors
from softgrip_nodekit.isolated import IsolatedNode
from softgrip_testing.waiting import TEST_TIMEOUT_S, wait_until

Serve = Callable[[Any, Any], Any]
Make = Callable[..., "tuple[Node, UrgentServer]"]


def _answer(_: Any, response: Any) -> Any:
    response.success, response.message = True, "stopped"
    return response


@pytest.fixture
def make() -> Iterator[Make]:
    made: list[tuple[Context, Node, UrgentServer]] = []

    def build(
        *arguments: str, callback: Serve = _answer, name: str = "estop", kind: Any = Trigger, **options: Any
    ) -> Any:
        context = Context()
        rclpy.init(args=["--ros-args", *arguments] if arguments else [], context=context)
        node = Node("driver", context=context)
        server = UrgentServer(node, kind, name, callback, **options)
        made.append((context, node, server))
        return node, server

    yield build
    for context, node, server in made:
        server.close()
        node.destroy_node()
        context.try_shutdown()


@pytest.fixture
def call() -> Iterator[Callable[..., Any]]:
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node("operator", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def ask(name: str, kind: Any = Trigger) -> Any:
        client = node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=TEST_TIMEOUT_S), name
        future = client.call_async(kind.Request())
        executor.spin_until_future_complete(future, timeout_sec=TEST_TIMEOUT_S)
        assert future.done(), f"{name} was not answered"
        return future.result()

    yield ask
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def test_it_answers_while_nobody_spins_its_node(make: Make, call: Callable[..., Any]) -> None:
    make()
    assert call("/estop").message == "stopped"


def test_it_says_for_how_long_it_has_stood_still(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    suspended_s = 0.0
    asked: list[float] = []

    def now_s() -> float:
        asked.append(suspended_s)
        return time.monotonic() + suspended_s

    monkeypatch.setattr(standstill, "boot_time_s", now_s)
    stood: list[float] = []
    make(on_standstill=stood.append)
    wait_until(lambda: len(asked) >= 2)
    suspended_s = 3600.0
    wait_until(lambda: bool(stood))
    assert stood[-1] == pytest.approx(3600.0, abs=60.0)


def test_in_an_emulated_cell_whose_time_waits_nobody_has_stood_still(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspended_s = 0.0
    asked: list[float] = []

    def now_s() -> float:
        asked.append(suspended_s)
        return time.monotonic() + suspended_s

    monkeypatch.setattr(standstill, "boot_time_s", now_s)
    monkeypatch.setattr(urgent, "time_waits_for", lambda _node: True)
    stood: list[float] = []
    make(on_standstill=stood.append)
    wait_until(lambda: len(asked) >= 2)
    suspended_s = 3600.0
    wait_until(lambda: asked.count(suspended_s) >= 3)
    assert stood == []


def test_it_answers_while_the_nodes_executor_stands_in_a_callback(make: Make, call: Callable[..., Any]) -> None:
    node, _ = make()
    inside, leave = threading.Event(), threading.Event()

    def stand() -> None:
        inside.set()
        leave.wait(TEST_TIMEOUT_S)

    node.create_timer(0.001, stand)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    try:
        assert inside.wait(TEST_TIMEOUT_S)
        assert call("/estop").success
    finally:
        leave.set()
        executor.shutdown()
        spinning.join()


def test_names_follow_the_nodes_arguments_and_both_nodes_keep_names_of_their_own(
    make: Make, call: Callable[..., Any]
) -> None:
    node, server = make("-r", "__node:=left_driver", "-r", "__ns:=/left", "-r", "estop:=all_stop")
    assert server.service_name == "/left/all_stop"
    assert call("/left/all_stop").success
    both = {"/left/left_driver", "/left/left_driver_urgent"}
    wait_until(lambda: both <= set(node.get_fully_qualified_node_names()))


def test_nothing_else_is_served_by_its_node(make: Make, call: Callable[..., Any]) -> None:
    node, _ = make()
    call("/estop")
    wait_until(lambda: "driver_urgent" in node.get_node_names())
    served = node.get_service_names_and_types_by_node("driver_urgent", "/")
    assert served == [("/estop", ["std_srvs/srv/Trigger"])]


def test_a_callback_that_raises_is_answered_with_the_reason_and_the_next_call_is_served(
    make: Make, call: Callable[..., Any]
) -> None:
    def fail(_: Any, response: Any) -> Any:
        failures.append(1)
        if len(failures) == 1:
            raise OSError("the disk is full")
        return _answer(_, response)

    failures: list[int] = []
    node, _ = make(callback=fail, kind=SetBool)
    first = call("/estop", SetBool)
    assert not first.success
    assert first.message == "OSError: the disk is full"
    assert (callback_errors(node).count, callback_errors(node).last) == (1, "OSError: the disk is full")
    assert call("/estop", SetBool).success


def test_a_response_of_the_wrong_kind_does_not_end_it(make: Make, call: Callable[..., Any]) -> None:
    spoiled = threading.Event()

    def serve(request: Any, response: Any) -> Any:
        if spoiled.is_set():
            return _answer(request, response)
        spoiled.set()
        return None

    node, _ = make(callback=serve)
    client = node.create_client(Trigger, "/estop")
    assert client.wait_for_service(timeout_sec=TEST_TIMEOUT_S)
    client.call_async(Trigger.Request())  # its answer is none
    assert spoiled.wait(TEST_TIMEOUT_S)  # another session's request may overtake it
    assert call("/estop").success
    assert callback_errors(node).count == 1, "said on /diagnostics"


def test_its_queue_thread_and_session_are_gone_once_it_is_closed(make: Make) -> None:
    node, server = make()
    assert "driver_urgent" in [thread.name for thread in threading.enumerate()]
    server.close()
    assert "driver_urgent" not in [thread.name for thread in threading.enumerate()]
    assert not server._isolated.node.context.ok()
    assert node.context.ok()
    server.close()  # a second time is no error


def test_a_signal_that_ends_the_context_at_the_same_moment_is_no_error(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rclpy looks and then shuts down; in between its signal thread may do so: seen with rmw_zenoh_cpp 0.2.10."""
    _, server = make()
    shut_down = Context.try_shutdown

    def too_late(context: Context) -> None:
        shut_down(context)
        raise RuntimeError("failed to shutdown: rcl_shutdown already called on the given context")

    with monkeypatch.context() as patch:
        patch.setattr(Context, "try_shutdown", too_late)
        server.close()
    assert not server._isolated.node.context.ok()


def test_an_executor_that_cannot_be_told_to_stop_does_not_keep_its_session(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, server = make()

    def down(*_: object, **__: object) -> None:
        raise RuntimeError("cannot use Destroyable because destruction was requested")

    with monkeypatch.context() as patch:
        patch.setattr(SingleThreadedExecutor, "shutdown", down)
        server.close()
    assert not server._isolated.node.context.ok()


def test_parameters_of_the_command_line_do_not_reach_its_node(make: Make) -> None:
    _, server = make("-p", "use_sim_time:=true")
    assert not server._isolated.node.get_parameter("use_sim_time").value


def test_its_node_lives_in_the_domain_of_the_other_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "71")
    context = Context()
    rclpy.init(args=[], context=context, domain_id=72)
    node = Node("driver", context=context)
    beside = IsolatedNode(node, "urgent", lambda _error: None)
    try:
        assert beside.node.context.get_domain_id() == 72
    finally:
        beside.close()
        node.destroy_node()
        context.try_shutdown()


def test_its_node_has_the_enclave_of_the_other_one_and_not_of_a_third(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What SROS 2 lets a process do goes by its enclave."""
    node, _ = make("-r", "__ns:=/cell")
    arguments: list[list[str]] = []
    init = rclpy.init

    def record_init(args: list[str], **options: Any) -> None:
        arguments.append(args)
        init(args=[], **options)

    monkeypatch.setattr(rclpy, "init", record_init)
    known = [("driver", "/", "/others"), ("driver", "/cell", "/cell/driver"), ("camera", "/cell", "/cell/camera")]
    monkeypatch.setattr(node, "get_node_names_and_namespaces_with_enclaves", lambda: known)
    IsolatedNode(node, "second", lambda _error: None).close()
    monkeypatch.setattr(node, "get_node_names_and_namespaces_with_enclaves", lambda: [("driver", "/cell", "/")])
    IsolatedNode(node, "third", lambda _error: None).close()
    assert arguments == [["--ros-args", "--enclave", "/cell/driver"], []]


def test_a_node_that_cannot_be_made_leaves_no_session_behind(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    node, _ = make()
    contexts: list[Context] = []

    def refuse(*_: object, context: Context, **__: object) -> None:
        contexts.append(context)
        raise RuntimeError("no participant left")

    monkeypatch.setattr(isolated, "Node", refuse)
    with pytest.raises(RuntimeError, match="no participant left"):
        IsolatedNode(node, "second", lambda _error: None)
    assert [context.ok() for context in contexts] == [False]


def test_it_can_be_closed_by_what_it_calls(make: Make, call: Callable[..., Any]) -> None:
    closed: list[str] = []

    def end(_: Any, response: Any) -> Any:
        server.close()
        closed.append("without an error")
        return response

    node, _ = make()
    server = UrgentServer(node, Trigger, "end", end)
    client = node.create_client(Trigger, "/end")
    assert client.wait_for_service(timeout_sec=TEST_TIMEOUT_S)
    client.call_async(Trigger.Request())  # nobody is left who would answer
    wait_until(lambda: closed == ["without an error"])


def test_whoever_closes_it_waits_until_its_thread_has_ended(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """The drives are closed next: nothing may answer a stop beside that."""
    spin = SingleThreadedExecutor.spin

    def end_slowly(executor: SingleThreadedExecutor) -> None:
        try:
            spin(executor)
        finally:
            time.sleep(0.3)

    monkeypatch.setattr(SingleThreadedExecutor, "spin", end_slowly)
    _, server = make()
    server.close()
    assert "driver_urgent" not in [thread.name for thread in threading.enumerate()]
