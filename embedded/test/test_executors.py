# SPDX-License-Identifier: Apache-2.0
"""Services, coroutines, exceptions and shutdown, as the executors run them."""

from __future__ import annotations

import collections
import importlib
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
import zenoh
from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from embedded_ros import wire

Make = Callable[..., Node]
Spin = Callable[..., bool]


def test_service_sync_async_and_coroutine(make_node: Make, context: Context) -> None:
    node = make_node("n")
    group = ReentrantCallbackGroup()
    inner = node.create_client(SetBool, "inner", callback_group=group)
    node.create_service(SetBool, "inner", _answer, callback_group=group)

    async def outer(_: Any, response: Any) -> Any:
        answered = await inner.call_async(SetBool.Request(data=True))
        response.success, response.message = answered.success, f"outer {answered.message}"
        return response

    node.create_service(Trigger, "outer", outer, callback_group=group)
    client = node.create_client(Trigger, "outer", callback_group=group)
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        assert client.wait_for_service(5.0)
        assert client.call(Trigger.Request(), timeout_sec=5.0) == Trigger.Response(success=True, message="outer inner")
    finally:
        executor.shutdown()
        thread.join()


def _answer(request: Any, response: Any) -> Any:
    response.success, response.message = request.data, "inner"
    return response


def test_an_exception_in_a_callback_reaches_who_spins(make_node: Make, context: Context) -> None:
    node = make_node("n")
    node.create_timer(0.0, lambda: 1 / 0)
    for executor in (SingleThreadedExecutor(context=context), MultiThreadedExecutor(2, context=context)):
        executor.add_node(node)
        with pytest.raises(ZeroDivisionError):
            executor.spin()
        executor.shutdown()


def test_shutdown_ends_a_spin_and_publishing(make_node: Make, context: Context) -> None:
    node = make_node("n")
    publisher = node.create_publisher(String, "t", 10)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Timer(0.05, context.shutdown).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()
    with pytest.raises(RCLError, match="context is invalid"):
        publisher.publish(String())


def test_a_message_that_comes_while_the_one_before_is_taken_is_run_at_once(
    make_node: Make, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between a look at the queue and its filling the executor may empty it: nobody else says that there is more."""

    class EmptiedMeanwhile(collections.deque[Any]):
        def append(self, item: Any) -> None:
            self.clear()
            super().append(item)

    node, heard = make_node("n"), []
    subscription = node.create_subscription(String, "t", lambda message: heard.append(message.data), 10)
    said: list[Any] = []
    monkeypatch.setattr(node, "_rcl_ready", said.append)
    sample = SimpleNamespace(
        attachment=zenoh.ZBytes(wire.encode_attachment(1, 2, bytes(16))),
        payload=zenoh.ZBytes(serialize_message(String(data="x"))),
    )
    subscription._queue = EmptiedMeanwhile(["being taken"], maxlen=10)
    subscription._on_sample(sample)
    assert said == [subscription]
    monkeypatch.undo()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    executor.spin_once(timeout_sec=1.0)
    executor.remove_node(node)
    assert heard == ["x"]


def test_what_is_not_there_is_refused_by_name(make_node: Make) -> None:
    with pytest.raises(NotImplementedError, match="EventsExecutor is not part of embedded/; it needs ROS 2"):
        rclpy.executors.EventsExecutor()
    with pytest.raises(NotImplementedError, match="deadline event"):
        SubscriptionEventCallbacks(deadline=print).create_event_handlers(None, None, "t")  # type: ignore[arg-type]
    subscription = make_node("n").create_subscription(String, "t", print, 10)
    assert not subscription.is_cft_enabled
    with pytest.raises(NotImplementedError, match="a content filter is not part"):
        subscription.set_content_filter("data = 'x'", [])
    for module in ("experimental", "service_introspection", "subscription_content_filter_options"):
        with pytest.raises(NotImplementedError, match="needs ROS 2"):
            importlib.import_module(f"rclpy.{module}")
