# SPDX-License-Identifier: Apache-2.0
"""Actions and lifecycle nodes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from example_interfaces.action import Fibonacci
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from std_msgs.msg import String

Make = Callable[..., Node]
Spin = Callable[..., bool]


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


def test_an_accepted_goal_runs_before_its_client_hears_of_that(make_node: Make, context: Context) -> None:
    node = make_node("n")
    follower = _Follower(node)
    client = ActionClient(node, Fibonacci, "fib")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    for _ in range(5):
        feedback: list[Any] = []
        answer = client.send_goal_async(Fibonacci.Goal(order=3), feedback_callback=feedback.append)
        executor.spin_until_future_complete(answer, 10.0)
        assert answer.result().accepted
        assert len(feedback) == 1
    executor.shutdown()
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


def test_goals_that_are_over_are_kept_for_late_questions_but_not_in_any_number(
    make_node: Make, context: Context
) -> None:
    node = make_node("n")
    follower = _Follower(node)
    client = ActionClient(node, Fibonacci, "fib")
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def wait(future: Any) -> Any:
        executor.spin_until_future_complete(future, 10.0)
        return future.result()

    goals = [wait(client.send_goal_async(Fibonacci.Goal(order=3))) for _ in range(130)]
    last = wait(goals[-1].get_result_async())
    assert (last.status, list(last.result.sequence)) == (4, [0, 1, 1])
    assert len(follower.server._goal_handles) == len(follower.server._result_futures) == 100
    assert wait(goals[0].get_result_async()).status == 0  # forgotten: UNKNOWN
    assert wait(goals[30].get_result_async()).status == 4  # the oldest of the last hundred
    executor.shutdown()
    client.destroy()
    follower.server.destroy()
