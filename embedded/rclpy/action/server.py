# SPDX-License-Identifier: Apache-2.0
"""Servers of actions: three services and two topics under the action's name."""

from __future__ import annotations

import collections
import inspect
import threading
import time
import traceback
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rclpy._rclpy_pybind11 import RCLError
from rclpy.action.goal_state import ACTIVE, GoalEvent, Status, goals_to_cancel, next_status
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_profile_action_status_default, qos_profile_services_default
from rclpy.service import Service
from rclpy.task import Future
from rclpy.type_support import check_is_valid_action_type
from rclpy.waitable import Waitable

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.service import RequestHeader

GoalT = TypeVar("GoalT")
ResultT = TypeVar("ResultT")
FeedbackT = TypeVar("FeedbackT")

_RESULT_TIMEOUT_S = 900
#: Goals that are over and still known, beside the timeout: each is in every status message.
_MAX_ENDED = 100


class GoalResponse(Enum):
    """What a goal callback may say."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse(Enum):
    """What a cancel callback may say."""

    REJECT = 1
    ACCEPT = 2


async def await_or_execute(callback: Callable[..., Any], *args: Any) -> Any:
    """Call a function or await a coroutine function."""
    result = callback(*args)
    return await result if inspect.isawaitable(result) else result


class ServerGoalHandle(Generic[GoalT, ResultT, FeedbackT]):
    """A goal that was accepted."""

    def __init__(self, action_server: ActionServer, goal_info: Any, goal_request: GoalT) -> None:
        self._action_server = action_server
        self._goal_info = goal_info
        self._goal_request = goal_request
        self._status = Status.ACCEPTED
        self._destroyed = False
        self._lock = threading.RLock()
        self._ended_at: float | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ServerGoalHandle) and self.goal_id == other.goal_id

    def __hash__(self) -> int:
        return hash(bytes(self.goal_id.uuid))

    @property
    def request(self) -> GoalT:
        """The goal."""
        return self._goal_request

    @property
    def goal_id(self) -> Any:
        """The goal's UUID."""
        return self._goal_info.goal_id

    @property
    def is_active(self) -> bool:
        """Whether it is not over."""
        return not self._destroyed and self._status in ACTIVE

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a cancel request was accepted."""
        return self.status == Status.CANCELING

    @property
    def status(self) -> int:
        """The status as action_msgs/GoalStatus has it."""
        return int(Status.UNKNOWN if self._destroyed else self._status)

    def _update_state(self, event: GoalEvent) -> None:
        with self._lock:
            if self._destroyed:
                return
            self._status = next_status(self._status, event)
            if self._status not in ACTIVE:
                self._ended_at = time.monotonic()
                self._action_server._keep_ended(self)
        self._action_server._publish_status()

    def _set_result(self, response: ResultT | None) -> None:
        server = self._action_server
        message = server._action_type.Impl.GetResultService.Response()
        message.status = self.status
        message.result = response if response is not None else server._action_type.Result()
        future = server._result_futures.get(bytes(self.goal_id.uuid))
        if future is not None:  # a hundred others may have ended meanwhile
            future.set_result(message)

    def execute(
        self, execute_callback: Callable[[ServerGoalHandle[GoalT, ResultT, FeedbackT]], Any] | None = None
    ) -> None:
        """Run the execute callback; a goal that is canceled already stays so."""
        if not self.is_cancel_requested:
            self.executing()
        self._action_server.notify_execute(self, execute_callback)

    def publish_feedback(self, feedback: FeedbackT) -> None:
        """Publish feedback on this goal."""
        kind = self._action_server._action_type
        if not isinstance(feedback, kind.Feedback):
            raise TypeError(f"expected {kind.Feedback}, found {type(feedback)}")
        if not self._destroyed:
            message = kind.Impl.FeedbackMessage(goal_id=self.goal_id, feedback=feedback)
            self._action_server._feedback.publish(message)

    def executing(self) -> None:
        """Report that the goal is being executed."""
        self._update_state(GoalEvent.EXECUTE)

    def succeed(self, response: ResultT | None = None) -> None:
        """End the goal: reached."""
        self._update_state(GoalEvent.SUCCEED)
        if response is not None:
            self._set_result(response)

    def abort(self, response: ResultT | None = None) -> None:
        """End the goal: given up."""
        self._update_state(GoalEvent.ABORT)
        if response is not None:
            self._set_result(response)

    def canceled(self, response: ResultT | None = None) -> None:
        """End the goal: canceled."""
        self._update_state(GoalEvent.CANCELED)
        if response is not None:
            self._set_result(response)

    def destroy(self) -> None:
        """Forget the goal."""
        self._destroyed = True


#: A goal of whichever action.
_AnyGoal = ServerGoalHandle[Any, Any, Any]


def default_handle_accepted_callback(goal_handle: _AnyGoal) -> None:
    """Execute the goal."""
    goal_handle.execute()


def default_goal_callback(goal_request: Any) -> GoalResponse:  # noqa: ARG001
    """Accept all goals."""
    return GoalResponse.ACCEPT


def default_cancel_callback(cancel_request: Any) -> CancelResponse:  # noqa: ARG001
    """Refuse to cancel."""
    return CancelResponse.REJECT


class ActionServer(Waitable):
    """Serves an action."""

    def __init__(
        self,
        node: Node,
        action_type: Any,
        action_name: str,
        execute_callback: Callable[[_AnyGoal], Any] | None = None,
        *,
        callback_group: CallbackGroup | None = None,
        goal_callback: Callable[[Any], Any] | None = default_goal_callback,
        handle_accepted_callback: Callable[[_AnyGoal], Any] | None = default_handle_accepted_callback,
        cancel_callback: Callable[[_AnyGoal], Any] | None = default_cancel_callback,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,
        result_service_qos_profile: QoSProfile = qos_profile_services_default,
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,
        feedback_pub_qos_profile: QoSProfile | None = None,
        status_pub_qos_profile: QoSProfile = qos_profile_action_status_default,
        result_timeout: float = _RESULT_TIMEOUT_S,
    ) -> None:
        group = callback_group or node.default_callback_group
        super().__init__(group)
        self._node = node
        self._logger = node.get_logger().get_child("action_server")
        self.register_handle_accepted_callback(handle_accepted_callback)
        self.register_goal_callback(goal_callback)
        self.register_cancel_callback(cancel_callback)
        self._execute_callback: Callable[[_AnyGoal], Any] | None = None
        if execute_callback:
            self.register_execute_callback(execute_callback)
        elif handle_accepted_callback is default_handle_accepted_callback:
            self._logger.warning("Not handling nor executing the goal, this server will do nothing")
        check_is_valid_action_type(action_type)
        self._action_type = action_type
        self._result_timeout = result_timeout
        self._goal_handles: dict[bytes, _AnyGoal] = {}
        self._ended: collections.deque[_AnyGoal] = collections.deque()  # the oldest first
        self._result_futures: dict[bytes, Future[Any]] = {}
        self._lock = threading.RLock()
        base = node.resolve_service_name(action_name) + "/_action/"
        impl = action_type.Impl

        def service(kind: Any, name: str, qos: QoSProfile) -> Service:
            return Service(node, kind, base + name, _never_called, group, qos)

        def publisher(kind: Any, name: str, qos: QoSProfile) -> Publisher:
            return Publisher(node, kind, base + name, qos, PublisherEventCallbacks(use_default_callbacks=False), group)

        self._feedback = publisher(impl.FeedbackMessage, "feedback", feedback_pub_qos_profile or QoSProfile(depth=10))
        self._status = publisher(impl.GoalStatusMessage, "status", status_pub_qos_profile)
        self._cancel = service(impl.CancelGoalService, "cancel_goal", cancel_service_qos_profile)
        self._result = service(impl.GetResultService, "get_result", result_service_qos_profile)
        self._goal = service(impl.SendGoalService, "send_goal", goal_service_qos_profile)
        group.add_entity(self)
        node.add_waitable(self)

    @property
    def action_type(self) -> Any:
        """The action's type."""
        return self._action_type

    # -- waiting ----------------------------------------------------------------------------------------------

    def _is_ready(self) -> bool:
        due = self._seconds_until_due()
        requests = self._goal._is_ready() or self._cancel._is_ready() or self._result._is_ready()
        return requests or (due is not None and due <= 0)

    def _seconds_until_due(self) -> float | None:
        if self._result_timeout < 0:
            return None
        try:
            ended_at = self._ended[0]._ended_at or 0.0
        except IndexError:
            return None
        return ended_at + self._result_timeout - time.monotonic()

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        self._expire()
        for service, execute in (
            (self._goal, self._execute_goal_request),
            (self._cancel, self._execute_cancel_request),
            (self._result, self._execute_get_result_request),
        ):
            if service._is_ready() and (taken := service._take_request()) is not None:
                return execute, taken
        return None

    def _expire(self) -> None:
        """Forget goals that ended longer ago than the result timeout."""
        if self._result_timeout < 0:
            return
        limit = time.monotonic() - self._result_timeout
        with self._lock:
            while self._ended and (self._ended[0]._ended_at or 0.0) <= limit:
                self._forget_oldest()

    def _keep_ended(self, goal: _AnyGoal) -> None:
        """Keep a goal that is over for who asks for its result late; with it the last hundred."""
        with self._lock:
            self._ended.append(goal)
            while len(self._ended) > _MAX_ENDED:
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        goal = self._ended.popleft()
        goal.destroy()
        key = bytes(goal.goal_id.uuid)
        self._goal_handles.pop(key, None)
        self._result_futures.pop(key, None)

    # -- requests ---------------------------------------------------------------------------------------------

    async def _execute_goal_request(self, request: Any, header: RequestHeader) -> None:
        from action_msgs.msg import GoalInfo  # noqa: PLC0415  classes are made on first use

        key = bytes(request.goal_id.uuid)
        response = self._action_type.Impl.SendGoalService.Response()
        goal_handle: _AnyGoal | None = None
        if key not in self._goal_handles:
            verdict = await await_or_execute(self._goal_callback, request.goal)
            if not isinstance(verdict, GoalResponse):
                self._logger.warning("Goal request callback did not return a GoalResponse type. Rejecting goal.")
            elif verdict is GoalResponse.ACCEPT:
                info = GoalInfo(goal_id=request.goal_id, stamp=self._node.get_clock().now().to_msg())
                goal_handle = ServerGoalHandle(self, info, request.goal)
                self._goal_handles[key] = goal_handle
                self._result_futures[key] = Future()
                response.accepted = True
                response.stamp = info.stamp
        self._goal.send_response(response, header)
        if goal_handle is not None:
            self._publish_status()
            await await_or_execute(self._handle_accepted_callback, goal_handle)

    async def _execute_goal(self, execute_callback: Callable[[_AnyGoal], Any], goal_handle: _AnyGoal) -> None:
        try:
            result = await await_or_execute(execute_callback, goal_handle)
        except Exception as error:  # noqa: BLE001  the client must get an answer whatever the callback did
            result = None
            self._logger.error(f"Error raised in execute callback: {error}")  # noqa: TRY400  a ROS logger
            traceback.print_exc()
        if result is not None and not isinstance(result, self._action_type.Result):
            self._logger.error(f"the execute callback returned {type(result)}, expected {self._action_type.Result}")
            result = None
        if goal_handle.is_active:
            self._logger.warning(f"Goal state not set, assuming aborted. Goal ID: {goal_handle.goal_id.uuid}")
            if goal_handle._status is Status.ACCEPTED:
                goal_handle.executing()
            goal_handle.abort()
        future = self._result_futures.get(bytes(goal_handle.goal_id.uuid))
        if result is not None or (future is not None and not future.done()):
            goal_handle._set_result(result)

    async def _execute_cancel_request(self, request: Any, header: RequestHeader) -> None:
        infos, code = goals_to_cancel(request, list(self._goal_handles.values()))
        response = self._action_type.Impl.CancelGoalService.Response(return_code=code)
        for info in infos:
            goal_handle = self._goal_handles.get(bytes(info.goal_id.uuid))
            if goal_handle is None:
                continue
            verdict = await await_or_execute(self._cancel_callback, goal_handle)
            if verdict is CancelResponse.ACCEPT:
                try:
                    goal_handle._update_state(GoalEvent.CANCEL_GOAL)
                except RCLError as error:
                    self._logger.debug(f"Failed to cancel goal in cancel callback: {error}")
                    continue
                response.goals_canceling.append(info)
        self._cancel.send_response(response, header)

    async def _execute_get_result_request(self, request: Any, header: RequestHeader) -> None:
        future = self._result_futures.get(bytes(request.goal_id.uuid))
        if future is None:
            response = self._action_type.Impl.GetResultService.Response(status=int(Status.UNKNOWN))
            self._result.send_response(response, header)
            return
        future.add_done_callback(lambda done: self._result.send_response(done.result(), header))

    def _publish_status(self) -> None:
        from action_msgs.msg import GoalStatus  # noqa: PLC0415  classes are made on first use

        message = self._action_type.Impl.GoalStatusMessage()
        message.status_list = [
            GoalStatus(goal_info=goal._goal_info, status=goal.status) for goal in list(self._goal_handles.values())
        ]
        if self._node.context.ok() and not self._status._destroyed:
            self._status.publish(message)

    def notify_execute(self, goal_handle: _AnyGoal, execute_callback: Callable[[_AnyGoal], Any] | None) -> None:
        """Make the executor run a goal."""
        callback = execute_callback or self._execute_callback
        executor = self._node.executor
        if callback is not None and executor is not None:
            executor.create_task(self._execute_goal, callback, goal_handle)

    # -- callbacks --------------------------------------------------------------------------------------------

    def register_handle_accepted_callback(self, handle_accepted_callback: Callable[[_AnyGoal], Any] | None) -> None:
        """Set what is called with each accepted goal."""
        self._handle_accepted_callback = handle_accepted_callback or default_handle_accepted_callback

    def register_goal_callback(self, goal_callback: Callable[[Any], Any] | None) -> None:
        """Set what decides on goals."""
        self._goal_callback = goal_callback or default_goal_callback

    def register_cancel_callback(self, cancel_callback: Callable[[_AnyGoal], Any] | None) -> None:
        """Set what decides on cancel requests."""
        self._cancel_callback = cancel_callback or default_cancel_callback

    def register_execute_callback(self, execute_callback: Callable[[_AnyGoal], Any]) -> None:
        """Set what executes goals."""
        if not callable(execute_callback):
            raise TypeError("Failed to register goal execution callback: not callable")
        self._execute_callback = execute_callback

    def destroy(self) -> None:
        """Withdraw."""
        for goal_handle in self._goal_handles.values():
            goal_handle.destroy()
        for endpoint in (self._goal, self._cancel, self._result, self._feedback, self._status):
            endpoint.destroy()
        self._node.remove_waitable(self)


def _never_called(request: Any, response: Any) -> Any:
    raise AssertionError(f"requests of actions go through the action server, not {request!r} {response!r}")
