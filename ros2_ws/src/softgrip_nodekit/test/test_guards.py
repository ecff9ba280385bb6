# SPDX-License-Identifier: Apache-2.0
"""What every node refuses, whatever rclpy would do: values of no type, and another kind of time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.time import Time

from softgrip_nodekit import CellNode, Diagnostics, Parameter, ParameterTable, StartupError, steady_timer
from softgrip_nodekit.guards import guard_parameter_services, settle_time

MakeNode = Callable[..., CellNode]


@pytest.fixture
def make_node() -> Iterator[MakeNode]:
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    nodes: list[CellNode] = []

    def make(*overrides: RosParameter) -> CellNode:
        nodes.append(CellNode("guarded", context=context, parameter_overrides=list(overrides)))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def ask(node: CellNode, kind: Any, name: str, value: ParameterValue) -> Any:
    """Call what serves a kind of request, as an executor would."""
    (service,) = [service for service in node.services if service.srv_type is kind]
    return service.callback(kind.Request(parameters=[ParameterMessage(name=name, value=value)]), kind.Response())


@pytest.mark.parametrize("kind", [SetParameters, SetParametersAtomically])
def test_a_value_of_no_type_is_refused_before_rclpy_sees_it(make_node: MakeNode, kind: Any) -> None:
    node = make_node()
    node.declare_parameter("speed", 1.0)
    seen: list[Any] = []
    (service,) = [service for service in node.services if service.srv_type is kind]
    inner = service.callback
    service.callback = lambda request, response: (seen.append(request), inner(request, response))[1]
    guard_parameter_services(node)

    def result(answer: Any) -> Any:
        return answer.results[0] if kind is SetParameters else answer.result

    refused = result(ask(node, kind, "speed", ParameterValue(type=200)))
    assert not refused.successful
    assert "expected a type 0 .. 9, found 200" in refused.reason
    assert seen == []
    assert result(ask(node, kind, "speed", ParameterValue(type=3, double_value=2.0))).successful
    assert node.get_parameter("speed").value == 2.0
    assert len(seen) == 1


@pytest.mark.parametrize("kind", [SetParameters, SetParametersAtomically])
@pytest.mark.parametrize(("number", "known"), [(9, True), (10, False)])
def test_the_last_type_is_known_and_the_next_is_not(make_node: MakeNode, kind: Any, number: int, known: bool) -> None:
    """PARAMETER_STRING_ARRAY is 9 in rcl_interfaces/msg/ParameterType, the last one."""
    node = make_node()
    node.declare_parameter("names", ["a"])
    guard_parameter_services(node)
    answer = ask(node, kind, "names", ParameterValue(type=number, string_array_value=["b"]))
    result = answer.results[0] if kind is SetParameters else answer.result
    assert result.successful is known
    assert ("expected a type 0 .. 9, found 10" in result.reason) is not known
    assert node.get_parameter("names").value == (["b"] if known else ["a"])


@pytest.mark.parametrize("kind", [SetParameters, SetParametersAtomically])
def test_one_value_of_no_type_refuses_all_that_come_with_it(make_node: MakeNode, kind: Any) -> None:
    node = make_node()
    node.declare_parameter("speed", 1.0)
    guard_parameter_services(node)
    values = [ParameterValue(type=3, double_value=2.0), ParameterValue(type=200)]
    (service,) = [service for service in node.services if service.srv_type is kind]
    request = kind.Request(parameters=[ParameterMessage(name="speed", value=value) for value in values])
    answer = service.callback(request, kind.Response())
    results = list(answer.results) if kind is SetParameters else [answer.result] * 2
    assert [result.successful for result in results] == [False, False]  # one for each, as the interface says
    assert node.get_parameter("speed").value == 1.0


@pytest.mark.parametrize("value", [True, False])
def test_the_kind_of_time_is_chosen_at_the_start_only(make_node: MakeNode, value: bool) -> None:
    node = make_node()
    settle_time(node)
    (result,) = node.set_parameters([RosParameter("use_sim_time", value=value)])
    assert not result.successful
    assert "at the start only" in result.reason
    assert not node.get_clock().ros_time_is_active


def test_simulated_time_and_a_real_device_exclude_each_other(make_node: MakeNode, tmp_path: Path) -> None:
    master, slave = os.openpty()
    emulated = tmp_path / "servo"
    emulated.symlink_to(os.ttyname(slave))
    real = tmp_path / "real"
    real.symlink_to("/dev/ttyUSB0")
    for path, refused in ((emulated, False), (real, True), (Path("/dev/ttyACM3"), True), (tmp_path / "later", False)):
        node = make_node(RosParameter("use_sim_time", value=True), RosParameter("port", value=str(path)))
        ParameterTable(Parameter("port", "", "of the servos", device=True)).declare(node)
        if refused:
            with pytest.raises(StartupError, match="real hardware, which knows no simulated time"):
                settle_time(node)
        else:
            settle_time(node)
    both = make_node(
        RosParameter("use_sim_time", value=True),
        RosParameter("port", value=str(emulated)),
        RosParameter("gauge", value=str(real)),
    )
    table = (Parameter("port", "", "of the servos", device=True), Parameter("gauge", "", "of the gauge", device=True))
    ParameterTable(*table).declare(both)
    with pytest.raises(StartupError, match="real is real hardware"):
        settle_time(both)
    without = make_node(RosParameter("port", value="/dev/ttyUSB0"))
    ParameterTable(Parameter("port", "", "of the servos", device=True)).declare(without)
    settle_time(without)
    os.close(master)
    os.close(slave)


def test_watch_timers_go_on_while_the_simulated_time_stands(make_node: MakeNode) -> None:
    node = make_node(RosParameter("use_sim_time", value=True))
    called: list[int] = []
    steady_timer(node, 0.01, lambda: called.append(1))
    Diagnostics(node)
    assert node.get_clock().now() == Time(clock_type=node.get_clock().clock_type)  # nobody publishes /clock
    for _ in range(100):
        rclpy.spin_once(node, executor=rclpy.executors.SingleThreadedExecutor(context=node.context), timeout_sec=0.1)
        if called:
            break
    assert called
    assert [timer.clock.clock_type.name for timer in node.timers] == ["STEADY_TIME"] * 3
