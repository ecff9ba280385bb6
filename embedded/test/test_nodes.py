# SPDX-License-Identifier: Apache-2.0
"""Nodes of one process: topics, services, parameters, QoS, time, actions, lifecycle."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from example_interfaces.action import Fibonacci
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import FloatingPointRange, Log, ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy._rclpy_pybind11 import RCLError
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterValueException, ParameterNotDeclaredException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

Make = Callable[..., Node]
Spin = Callable[..., bool]


def test_topic_with_message_info_and_raw(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    plain: list[str] = []
    infos: list[dict[str, Any]] = []
    raw: list[bytes] = []
    node.create_subscription(String, "t", lambda m: plain.append(m.data), 10)
    node.create_subscription(String, "t", lambda _, info: infos.append(info), 10)
    node.create_subscription(String, "t", raw.append, 10, raw=True)
    publisher = node.create_publisher(String, "t", 10)
    assert publisher.get_subscription_count() == 3
    before = time.time_ns()
    publisher.publish(String(data="a"))
    publisher.publish(String(data="b"))
    assert spin_until(lambda: len(plain) == 2 and len(infos) == 2 and len(raw) == 2, node)
    assert plain == ["a", "b"]
    assert raw[0] == bytes.fromhex("00010000" + "02000000" + "6100")
    assert before <= infos[0]["source_timestamp"] <= infos[0]["received_timestamp"] <= time.time_ns()
    assert [info["publication_sequence_number"] for info in infos] == [1, 2]


def test_threads_that_publish_at_once_number_every_message_once(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    count, threads = 300, 4
    numbers: list[int] = []
    node.create_subscription(
        String, "t", lambda _, info: numbers.append(info["publication_sequence_number"]), count * threads
    )
    publisher = node.create_publisher(String, "t", count * threads)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        workers = [threading.Thread(target=_publish, args=(publisher, count)) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        sys.setswitchinterval(interval)
    assert spin_until(lambda: len(numbers) == count * threads, node)
    assert sorted(numbers) == list(range(1, count * threads + 1))


def _publish(publisher: Any, count: int) -> None:
    for _ in range(count):
        publisher.publish(String())


def test_a_second_argument_with_a_default_is_no_message_info(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    got: list[object] = []
    node.create_subscription(String, "t", lambda _, extra="default": got.append(extra), 10)
    node.create_publisher(String, "t", 10).publish(String())
    assert spin_until(lambda: got == ["default"], node)


def test_a_wrong_field_is_refused_where_it_is_published(make_node: Make) -> None:
    publisher = make_node("n").create_publisher(Float64, "t", 10)
    with pytest.raises(TypeError, match=r"Float64.data: expected float, found builtins.int 1"):
        publisher.publish(Float64(data=1))
    with pytest.raises(TypeError, match="Expected"):
        publisher.publish(String())


def test_a_full_queue_drops_the_oldest_and_says_so(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    heard: list[str] = []
    lost: list[int] = []
    events = SubscriptionEventCallbacks(message_lost=lambda event: lost.append(event.total_count))
    node.create_subscription(String, "t", lambda m: heard.append(m.data), 2, event_callbacks=events)
    publisher = node.create_publisher(String, "t", 10)
    for i in range(5):
        publisher.publish(String(data=str(i)))
    assert spin_until(lambda: len(heard) == 2 and bool(lost), node)
    assert heard == ["3", "4"]
    assert spin_until(lambda: lost[-1] == 3, node)


def test_a_latched_value_reaches_who_comes_late(make_node: Make, spin_until: Spin) -> None:
    node = make_node("n")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "t", latched).publish(String(data="kept"))
    heard: list[str] = []
    node.create_subscription(String, "t", lambda m: heard.append(m.data), latched)
    assert spin_until(lambda: heard == ["kept"], node)


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT), QoSProfile(depth=5), "RELIABILITY"),
        (QoSProfile(depth=5), QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL), "DURABILITY"),
    ],
)
def test_incompatible_qos_delivers_nothing_and_names_the_policy(
    make_node: Make,
    spin_until: Spin,
    capfd: pytest.CaptureFixture[str],
    offered: QoSProfile,
    requested: QoSProfile,
    policy: str,
) -> None:
    node = make_node("n")
    heard: list[str] = []
    fine: list[str] = []
    node.create_subscription(String, "t", lambda m: heard.append(m.data), requested)
    node.create_subscription(String, "t", lambda m: fine.append(m.data), offered)
    publisher = node.create_publisher(String, "t", offered)
    assert publisher.get_subscription_count() == 1
    publisher.publish(String(data="x"))
    assert spin_until(lambda: fine == ["x"], node)
    spin_until(lambda: False, node, deadline_s=0.2)
    assert heard == []
    text = capfd.readouterr().err
    assert (
        text.count(
            f"offering incompatible QoS. No messages will be received from it. Last incompatible policy: {policy}"
        )
        == 1
    )


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
        _event_type(), "/parameter_events", lambda m: events.append(m) if m.node == "/n" else None, 10
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


def _event_type() -> Any:
    from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415

    return ParameterEvent


def test_the_log_goes_to_rosout_with_its_place(make_node: Make, spin_until: Spin) -> None:
    node, other = make_node("n"), make_node("other")
    logs: list[Any] = []
    other.create_subscription(Log, "/rosout", logs.append, 10)
    node.get_logger().get_child("part").warning("careful")
    assert spin_until(lambda: len(logs) == 1, node, other)
    assert (logs[0].name, logs[0].level, logs[0].msg) == ("n.part", 30, "careful")
    assert logs[0].function == "test_the_log_goes_to_rosout_with_its_place"
    assert logs[0].file == __file__


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


class _Follower:
    """An action server that follows orders given by the goal."""

    def __init__(self, node: Node) -> None:
        self.go = threading.Event()
        self.server = ActionServer(
            node, Fibonacci, "fib", self._execute, callback_group=ReentrantCallbackGroup(),
            goal_callback=lambda goal: GoalResponse.ACCEPT if goal.order >= 0 else GoalResponse.REJECT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def _execute(self, goal: Any) -> Any:
        goal.publish_feedback(Fibonacci.Feedback(sequence=[0]))
        if goal.request.order == 99:
            raise RuntimeError("broken")
        while goal.request.order == 50 and not goal.is_cancel_requested:
            self.go.wait(0.01)
        if goal.is_cancel_requested:
            goal.canceled()
            return Fibonacci.Result(sequence=[-1])
        goal.succeed()
        return Fibonacci.Result(sequence=[0, 1, 1])


def test_actions(make_node: Make, context: Context) -> None:
    node = make_node("n")
    follower = _Follower(node)
    client = ActionClient(node, Fibonacci, "fib")
    executor = MultiThreadedExecutor(3, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    feedback: list[Any] = []

    def wait(future: Any) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(10)
        return future.result()

    try:
        assert client.wait_for_server(5.0)
        goal = wait(client.send_goal_async(Fibonacci.Goal(order=3), feedback_callback=feedback.append))
        result = wait(goal.get_result_async())
        assert (result.status, list(result.result.sequence)) == (4, [0, 1, 1])
        assert [list(message.feedback.sequence) for message in feedback] == [[0]]
        assert not wait(client.send_goal_async(Fibonacci.Goal(order=-1))).accepted
        broken = wait(client.send_goal_async(Fibonacci.Goal(order=99)))
        assert wait(broken.get_result_async()).status == 6
        endless = wait(client.send_goal_async(Fibonacci.Goal(order=50)))
        assert len(wait(endless.cancel_goal_async()).goals_canceling) == 1
        canceled = wait(endless.get_result_async())
        assert (canceled.status, list(canceled.result.sequence)) == (5, [-1])
        assert wait(endless.cancel_goal_async()).return_code == 3
    finally:
        executor.shutdown()
        thread.join()
        client.destroy()
        follower.server.destroy()


class _Machine(LifecycleNode):
    """Fails to activate once; counts what it publishes."""

    fail = True

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.output = self.create_lifecycle_publisher(String, "out", 10)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.fail:
            self.fail = False
            return TransitionCallbackReturn.FAILURE
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        raise RuntimeError(f"cannot clean up from {state.label}")


def test_lifecycle(context: Context, make_node: Make, spin_until: Spin) -> None:
    machine = _Machine("machine", context=context)
    caller = make_node("caller")
    heard: list[str] = []
    caller.create_subscription(String, "out", lambda m: heard.append(m.data), 10)
    change = caller.create_client(ChangeState, "/machine/change_state")
    state = caller.create_client(GetState, "/machine/get_state")

    def to(label: str) -> tuple[bool, str]:
        request = ChangeState.Request()
        request.transition.label = label
        changed = change.call_async(request)
        assert spin_until(changed.done, machine, caller)
        now = state.call_async(GetState.Request())
        assert spin_until(now.done, machine, caller)
        return changed.result().success, now.result().current_state.label

    assert to("activate") == (False, "unconfigured")
    assert to("configure") == (True, "inactive")
    machine.output.publish(String(data="too early"))
    assert to("activate") == (False, "inactive")
    assert to("activate") == (True, "active")
    machine.output.publish(String(data="now"))
    assert spin_until(lambda: heard == ["now"], machine, caller)
    assert to("deactivate") == (True, "inactive")
    assert to("cleanup") == (False, "unconfigured")  # on_error is handled, so it goes back to unconfigured
    assert machine.trigger_shutdown() is TransitionCallbackReturn.SUCCESS
    machine.destroy_node()


def test_what_is_not_there_is_refused_by_name() -> None:
    with pytest.raises(NotImplementedError, match="EventsExecutor is not part of embedded/; it needs ROS 2"):
        rclpy.executors.EventsExecutor()
    with pytest.raises(NotImplementedError, match="deadline event"):
        SubscriptionEventCallbacks(deadline=print).create_event_handlers(None, None, "t")  # type: ignore[arg-type]
