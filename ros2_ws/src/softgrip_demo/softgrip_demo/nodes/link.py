# SPDX-License-Identifier: Apache-2.0
"""Waiting with a deadline, and services and actions as plain calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.clock import Clock
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_demo.errors import ShiftError
from softgrip_interfaces.action import CalibrateFriction
from softgrip_nodekit import duration_clock
from softgrip_nodekit.errors import SuccessResponseT
from softgrip_time.units import to_ns

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.task import Future
    from rclpy.type_support import FeedbackMessage

    from softgrip_nodekit.node_io import ActionType, ServiceType

T = TypeVar("T")
Request = TypeVar("Request")
Goal = TypeVar("Goal")
Result = TypeVar("Result", bound="ReasonedResult")
Feedback = TypeVar("Feedback")

#: What the reason of a calibration that may go on says, and how often it is tried.
RESUMABLE, CALIBRATION_TRIES = "resume the plan", 4
POLL = 0.05  # [s] between looks at a condition while the executor spins


class ReasonedResult(Protocol):
    """A result of an action that says why it ended so."""

    @property
    def reason(self) -> str:
        """In words."""


class CellLink:
    """Calls services and actions of the cell from one thread, spinning the executor while it waits."""

    def __init__(self, node: Node, executor: Executor) -> None:
        self.node = node
        self._executor = executor
        self._durations = duration_clock(node)
        self._service_clients: dict[str, Client[Any, Any]] = {}
        self._action_clients: dict[str, ActionClient[Any, Any, Any]] = {}

    def until(self, condition: Callable[[], bool], timeout: float, expected: str, clock: Clock | None = None) -> None:
        """Spin until a condition holds.

        Args:
            condition: is asked after each callback.
            timeout: [s].
            expected: in words, for the error.
            clock: of the time-out; None = that of the cell's durations.

        Raises:
            ShiftError: when it does not within ``timeout`` [s].
        """
        clock = clock or self._durations
        deadline = clock.now() + Duration(nanoseconds=to_ns(timeout))
        while not condition():
            if clock.now() > deadline:
                raise ShiftError(f"expected {expected} within {timeout:g} s, found nothing; see the log of the cell")
            self._executor.spin_once(timeout_sec=POLL)

    def pause(self, duration_s: float, why: str) -> None:
        """Spin for a time [s] of the cell."""
        end = self._durations.now() + Duration(nanoseconds=to_ns(duration_s))
        self.until(lambda: self._durations.now() >= end, 2.0 * duration_s + 10.0, why)

    def wait(self, future: Future[T], timeout: float, expected: str) -> T:
        """Spin until a future is done and return its result."""
        self.until(future.done, timeout, expected)
        return future.result()

    def call(
        self,
        service_type: ServiceType[Request, SuccessResponseT],
        name: str,
        request: Request,
        timeout: float = 10.0,
    ) -> SuccessResponseT:
        """Call a service; a response with ``success`` false is an error."""
        client: Client[Request, SuccessResponseT] | None = self._service_clients.get(name)
        if client is None:
            client = self._service_clients[name] = self.node.create_client(service_type, name)
        self.until(client.service_is_ready, timeout, f"service {name}")
        response = self.wait(client.call_async(request), timeout, f"an answer of service {name}")
        if not response.success:
            raise ShiftError(f"{name} refused: {response.message}")
        return response

    def act(
        self,
        action_type: ActionType[Goal, Result, Feedback],
        name: str,
        goal: Goal,
        *,
        feedback: Callable[[Feedback], None] | None = None,
        timeout: float = 60.0,
    ) -> Result:
        """Run an action to its end and return its result message.

        Raises:
            ShiftError: when the server is missing, rejects the goal, is cancelled, or takes over ``timeout`` [s].
        """
        client: ActionClient[Goal, Result, Feedback] | None = self._action_clients.get(name)
        if client is None:
            client = self._action_clients[name] = ActionClient(self.node, action_type, name)
        self.until(client.server_is_ready, 10.0, f"action {name}")

        def on_feedback(message: FeedbackMessage[Feedback]) -> None:
            if feedback is not None:
                feedback(message.feedback)

        handle = self.wait(client.send_goal_async(goal, feedback_callback=on_feedback), 10.0, f"{name} to take a goal")
        if not handle.accepted:
            raise ShiftError(f"action {name} rejected the goal {goal}")
        answer = self.wait(handle.get_result_async(), timeout, f"action {name} to end")
        if answer.status not in {GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED}:
            raise ShiftError(f"action {name} ended with status {answer.status}: {answer.result.reason}")
        return answer.result


def calibrate(
    link: CellLink,
    goal: CalibrateFriction.Goal,
    set_up: Callable[[CalibrateFriction.Feedback], None],
    timeout: float,
) -> CalibrateFriction.Result:
    """Run the rig's plan, again where it can be resumed, and return its result.

    Args:
        link: to the cell.
        goal: the plan.
        set_up: called with the feedback that asks for an angle and a mass; they are set when it returns.
        timeout: [s] for one try.

    Raises:
        ShiftError: the rig does not answer or fails.
    """
    confirm = link.node.create_client(Trigger, "rig/confirm")

    def on_feedback(feedback: CalibrateFriction.Feedback) -> None:
        if feedback.phase == feedback.SET_UP:
            set_up(feedback)
            confirm.call_async(Trigger.Request())

    for _ in range(CALIBRATION_TRIES):
        result = link.act(CalibrateFriction, "rig/calibrate", goal, feedback=on_feedback, timeout=timeout)
        if result.outcome == result.SUCCEEDED:
            return result
        link.node.get_logger().warning(f"rig: {result.reason}")
        if RESUMABLE not in result.reason:
            break
        goal.resume = True
    raise ShiftError(f"rig/calibrate failed: {result.reason}")
