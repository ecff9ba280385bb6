# SPDX-License-Identifier: Apache-2.0
"""What a node has beside its endpoints: parameters, log, simulated time, the graph."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import FloatingPointRange, Log, ParameterDescriptor, ParameterEvent, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.exceptions import InvalidParameterValueException, ParameterNotDeclaredException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_rosout_default
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from embedded_ros.wire import EntityKind, encode_token

Make = Callable[..., Node]
Spin = Callable[..., bool]


class CountingExecutor(SingleThreadedExecutor):
    """Counts how often it polls at all that a node has."""

    polls = 0

    def _look(self, nodes: list[Node] | None) -> Iterator[Any]:
        self.polls += 1
        return super()._look(nodes)


def holds(condition: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.001)
    return condition()


def test_parameters_are_checked_before_they_are_set(make_node: Make) -> None:
    node = make_node("n")
    limits = ParameterDescriptor(floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1.0)])
    node.declare_parameter("share", 0.5, limits)
    node.declare_parameter("fixed", "x", ParameterDescriptor(read_only=True))
    seen: list[list[Parameter]] = []

    def veto(parameters: list[Parameter]) -> Any:
        bad = any(parameter.value == 0.25 for parameter in parameters)
        return SetParametersResult(successful=not bad, reason="not a quarter" if bad else "")

    node.add_on_set_parameters_callback(veto)
    node.add_post_set_parameters_callback(seen.append)
    reasons = {
        value: node.set_parameters([Parameter(name, value=value)])[0].reason
        for name, value in (("share", 2.0), ("share", 1), ("share", 0.25), ("fixed", "y"), ("share", 0.75))
    }
    assert "out of range" in reasons[2.0]
    assert "Wrong parameter type" in reasons[1]
    assert reasons[0.25] == "not a quarter"
    assert "read-only" in reasons["y"]
    assert reasons[0.75] == ""
    assert node.get_parameter("share").value == 0.75
    assert [parameter.value for call in seen for parameter in call] == [0.75]
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter("nope")
    with pytest.raises(InvalidParameterValueException):
        node.declare_parameter("other", 3.0, ParameterDescriptor(floating_point_range=limits.floating_point_range))


def test_overrides_of_the_command_line_apply_to_the_node_they_name(make_node: Make) -> None:
    node = make_node(
        "n",
        cli_args=[
            "--ros-args",
            "-r",
            "__ns:=/cell",
            "-r",
            "t:=u",
            "-p",
            "a:=2.5",
            "-p",
            "other:a:=9.0",
            "-p",
            "b:=[1, 2]",
        ],
    )
    assert node.get_fully_qualified_name() == "/cell/n"
    assert node.declare_parameter("a", 1.0).value == 2.5
    assert node.declare_parameter("b", [0]).value == [1, 2]
    assert node.resolve_topic_name("t") == "/cell/u"
    assert node.resolve_topic_name("~/t") == "/cell/n/t"


def test_parameter_services_and_events(make_node: Make, spin_until: Spin) -> None:
    node, other = make_node("n"), make_node("other")
    node.declare_parameter("x", 1)
    events: list[Any] = []
    other.create_subscription(
        ParameterEvent, "/parameter_events", lambda m: events.append(m) if m.node == "/n" else None, 10
    )
    setter = other.create_client(SetParameters, "/n/set_parameters")
    getter = other.create_client(GetParameters, "/n/get_parameters")
    done = setter.call_async(SetParameters.Request(parameters=[Parameter("x", value=5).to_parameter_msg()]))
    assert spin_until(done.done, node, other)
    assert done.result().results[0].successful
    values = getter.call_async(GetParameters.Request(names=["x"]))
    assert spin_until(values.done, node, other)
    assert values.result().values[0].integer_value == 5
    assert spin_until(lambda: len(events) == 1, node, other)
    assert events[0].changed_parameters[0].name == "x"


def test_the_log_goes_to_rosout_with_its_place(make_node: Make, spin_until: Spin) -> None:
    node, other = make_node("n"), make_node("other")
    logs: list[Any] = []
    # as kept for late comers; what others in the domain log does not count
    other.create_subscription(Log, "/rosout", logs.append, qos_profile_rosout_default)
    node.get_logger().get_child("part").warning("careful")
    assert spin_until(lambda: any(log.name == "n.part" for log in logs), node, other)
    (log,) = [log for log in logs if log.name == "n.part"]
    assert (log.level, log.msg) == (30, "careful")
    assert log.function == "test_the_log_goes_to_rosout_with_its_place"
    assert log.file == __file__


def test_simulated_time_drives_timers(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n", parameter_overrides=[Parameter("use_sim_time", value=True)])
    clock = make_node("clock").create_publisher(Clock, "/clock", 10)
    calls: list[int] = []
    timer = node.create_timer(10.0, lambda: calls.append(node.get_clock().now().nanoseconds))
    for second in range(1, 35):
        message = Clock()
        message.clock.sec = second
        clock.publish(message)
        at = second * 10**9
        assert spin_until(lambda at=at: node.get_clock().now().nanoseconds == at, node)
        spin_until(lambda: False, node, deadline_s=0.0)
        if timer.is_ready():
            assert spin_until(lambda: not timer.is_ready(), node)
    assert len(calls) == 3
    assert [round(at / 1e9) % 10 for at in calls] == [calls[0] // 10**9 % 10] * 3


def test_the_clock_goes_on_without_the_executor_which_wakes_for_due_timers_alone(make_node: Make) -> None:
    node = make_node("n", parameter_overrides=[Parameter("use_sim_time", value=True)])
    clock = make_node("clock").create_publisher(Clock, "/clock", 10)
    calls: list[int] = []

    def tell(second: int) -> None:
        clock.publish(Clock(clock=Time(sec=second)))
        assert holds(lambda: node.get_clock().now().nanoseconds == second * 10**9)

    tell(1)  # nobody spins
    node.create_timer(10.0, lambda: calls.append(node.get_clock().now().nanoseconds // 10**9))
    executor = CountingExecutor(context=node.context)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    try:
        assert holds(lambda: executor.polls > 0)
        began, before = time.monotonic(), executor.polls
        for second in range(2, 102):
            tell(second)
            assert holds(lambda second=second: len(calls) == (second - 1) // 10)
        assert executor.polls - before <= 10.0 * (time.monotonic() - began) + 2  # those of every tenth of a second
        assert calls == list(range(11, 102, 10))
    finally:
        executor.shutdown()
        spinning.join(5.0)


def test_graph_queries(make_node: Make) -> None:
    node = make_node("n", namespace="/cell")
    node.create_publisher(String, "t", 7)
    node.create_service(Trigger, "s", lambda _, response: response)
    assert ("n", "/cell") in node.get_node_names_and_namespaces()
    assert ("/cell/t", ["std_msgs/msg/String"]) in node.get_topic_names_and_types()
    assert ("/cell/s", ["std_srvs/srv/Trigger"]) in node.get_service_names_and_types_by_node("n", "/cell")
    (info,) = node.get_publishers_info_by_topic("t")
    assert (info.node_name, info.node_namespace, info.qos_profile.depth) == ("n", "/cell", 7)
    assert node.count_publishers("t") == 1
    node.destroy_node()
    assert node.get_node_names() == []


def test_a_server_is_there_when_a_request_finds_its_way_to_it(make_node: Make) -> None:
    node = make_node("n")
    client = node.create_client(Trigger, "s")
    announced = dataclasses.replace(client._entity, zid="feed", kind=EntityKind.SERVICE)
    node.context._graph.add(encode_token(announced))  # its token is here, what it stands for is not
    assert not client.service_is_ready()
    assert not client.wait_for_service(0.05)
    node.create_service(Trigger, "s", lambda _, response: response)
    assert client.wait_for_service(5.0)
    node.destroy_client(client)
    assert not client.service_is_ready()
