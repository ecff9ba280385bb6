# SPDX-License-Identifier: Apache-2.0
"""Clients of actions."""

from __future__ import annotations

import threading
import time
import uuid
import weakref
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from rclpy.client import REACH_PERIOD_S, Client
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, qos_profile_action_status_default, qos_profile_services_default
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.type_support import check_is_valid_action_type
from rclpy.waitable import Waitable

from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.type_support import FeedbackMessage, GetResultServiceResponse

T = TypeVar("T")
GoalT = TypeVar("GoalT")
ResultT = TypeVar("ResultT")
FeedbackT = TypeVar("FeedbackT")


class ClientGoalHandle(Generic[GoalT, ResultT, FeedbackT]):
    """A goal that a server answered."""

    def __init__(
        self, action_client: ActionClient[GoalT, ResultT, FeedbackT], goal_id: Any, goal_response: Any
    ) -> None:
        self._action_client = action_client
        self._goal_id = goal_id
        self._goal_response = goal_response
        self._status = 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ClientGoalHandle) and self._goal_id == other._goal_id

    def __hash__(self) -> int:
        return hash(bytes(self._goal_id.uuid))

    def __repr__(self) -> str:
        return f"ClientGoalHandle <id={self._goal_id.uuid}, accepted={self.accepted}, status={self.status}>"

    @property
    def goal_id(self) -> Any:
        """The goal's UUID."""
        return self._goal_id

    @property
    def stamp(self) -> Any:
        """When it was accepted."""
        return self._goal_response.stamp

    @property
    def accepted(self) -> bool:
        """Whether it was accepted."""
        return bool(self._goal_response.accepted)

    @property
    def status(self) -> int:
        """The last status heard."""
        return self._status

    def cancel_goal(self) -> Any:
        """Ask to cancel, and wait for the answer; another thread must spin."""
        return _wait(self.cancel_goal_async())

    def cancel_goal_async(self) -> Future[Any]:
        """Ask to cancel; the future ends with the answer."""
        return self._action_client._cancel_goal_async(self)

    def get_result(self) -> GetResultServiceResponse[ResultT]:
        """Wait for the result; another thread must spin."""
        return _wait(self.get_result_async())

    def get_result_async(self) -> Future[GetResultServiceResponse[ResultT]]:
        """Ask for the result; the future ends with status and result."""
        return self._action_client._get_result_async(self)


def _wait(future: Future[T]) -> T:
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    done.wait()
    return future.result()


class ActionClient(Waitable, Generic[GoalT, ResultT, FeedbackT]):
    """Sends goals to an action server."""

    def __init__(
        self,
        node: Node,
        action_type: Any,
        action_name: str,
        *,
        callback_group: CallbackGroup | None = None,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,
        result_service_qos_profile: QoSProfile = qos_profile_services_default,
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,
        feedback_sub_qos_profile: QoSProfile | None = None,
        status_sub_qos_profile: QoSProfile = qos_profile_action_status_default,
    ) -> None:
        group = callback_group or node.default_callback_group
        super().__init__(group)
        check_is_valid_action_type(action_type)
        self._node = node
        self._action_type = action_type
        self._action_name = action_name
        self._feedback_callbacks: dict[bytes, Callable[[FeedbackMessage[FeedbackT]], Any]] = {}
        self._goal_handles: dict[bytes, weakref.ref[ClientGoalHandle[GoalT, ResultT, FeedbackT]]] = {}
        base = node.resolve_service_name(action_name) + "/_action/"
        impl = action_type.Impl

        def client(kind: Any, name: str, qos: QoSProfile) -> Client[Any, Any]:
            return Client(node, kind, base + name, qos, group)

        def subscription(kind: Any, name: str, qos: QoSProfile, callback: Callable[[Any], Any]) -> Subscription:
            events = SubscriptionEventCallbacks(use_default_callbacks=False)
            return Subscription(node, kind, base + name, callback, group, qos, raw=False, event_callbacks=events)

        self._send_client = client(impl.SendGoalService, "send_goal", goal_service_qos_profile)
        self._cancel_client = client(impl.CancelGoalService, "cancel_goal", cancel_service_qos_profile)
        self._result_client = client(impl.GetResultService, "get_result", result_service_qos_profile)
        feedback_qos = feedback_sub_qos_profile or QoSProfile(depth=10)
        self._feedback = subscription(impl.FeedbackMessage, "feedback", feedback_qos, self._on_feedback)
        self._status = subscription(impl.GoalStatusMessage, "status", status_sub_qos_profile, self._on_status)
        self._endpoints = (self._send_client, self._cancel_client, self._result_client, self._status, self._feedback)
        group.add_entity(self)
        node.add_waitable(self)

    def _is_ready(self) -> bool:
        return any(endpoint._is_ready() for endpoint in self._endpoints)

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        # Feedback before responses: it was sent before the result.
        endpoint: Client[Any, Any] | Subscription
        for endpoint in reversed(self._endpoints):
            if endpoint._is_ready() and (work := endpoint._take()) is not None:
                return work
        return None

    async def _on_feedback(self, message: FeedbackMessage[FeedbackT]) -> None:
        callback = self._feedback_callbacks.get(bytes(message.goal_id.uuid))
        if callback is not None:
            result = callback(message)
            if hasattr(result, "__await__"):
                await result

    def _on_status(self, message: Any) -> None:
        for status in message.status_list:
            key = bytes(status.goal_info.goal_id.uuid)
            reference = self._goal_handles.get(key)
            goal = reference() if reference is not None else None
            if goal is not None:
                goal._status = status.status
            if status.status >= 4:
                self._feedback_callbacks.pop(key, None)
                self._goal_handles.pop(key, None)

    def send_goal(self, goal: GoalT, **kwargs: Any) -> GetResultServiceResponse[ResultT] | None:
        """Send a goal and wait for its result; another thread must spin."""
        if not isinstance(goal, self._action_type.Goal):
            raise TypeError(f"expected {self._action_type.Goal}, found {type(goal)}")
        goal_handle = _wait(self.send_goal_async(goal, **kwargs))
        return goal_handle.get_result() if goal_handle.accepted else None

    def send_goal_async(
        self,
        goal: GoalT,
        feedback_callback: Callable[[FeedbackMessage[FeedbackT]], Any] | None = None,
        goal_uuid: Any = None,
    ) -> Future[ClientGoalHandle[GoalT, ResultT, FeedbackT]]:
        """Send a goal; the future ends with a :class:`ClientGoalHandle`."""
        from unique_identifier_msgs.msg import UUID  # noqa: PLC0415  classes are made on first use

        if not isinstance(goal, self._action_type.Goal):
            raise TypeError(f"expected {self._action_type.Goal}, found {type(goal)}")
        goal_id = goal_uuid or UUID(uuid=np.frombuffer(uuid.uuid4().bytes, np.uint8))
        key = bytes(goal_id.uuid)
        if feedback_callback is not None:
            self._feedback_callbacks[key] = feedback_callback
        request = self._action_type.Impl.SendGoalService.Request(goal_id=goal_id, goal=goal)
        future: Future[ClientGoalHandle[GoalT, ResultT, FeedbackT]] = Future(executor=self._node.executor)

        def answered(response: Future[Any]) -> None:
            if response.cancelled():
                future.cancel()
                return
            if response._exception is not None:
                future.set_exception(response._exception)
                return
            handle = ClientGoalHandle(self, goal_id, response.result())
            if handle.accepted:
                if key in self._goal_handles and self._goal_handles[key]() is not None:
                    future.set_exception(RuntimeError(f"Two goals were accepted with the same ID ({handle})"))
                    return
                self._goal_handles[key] = weakref.ref(handle)
            else:
                self._feedback_callbacks.pop(key, None)
            future.set_result(handle)

        self._send_client.call_async(request).add_done_callback(answered)
        return future

    def _cancel_goal_async(self, goal_handle: ClientGoalHandle[GoalT, ResultT, FeedbackT]) -> Future[Any]:
        request = self._action_type.Impl.CancelGoalService.Request()
        request.goal_info.goal_id = goal_handle.goal_id
        return self._cancel_client.call_async(request)

    def _get_result_async(
        self, goal_handle: ClientGoalHandle[GoalT, ResultT, FeedbackT]
    ) -> Future[GetResultServiceResponse[ResultT]]:
        request = self._action_type.Impl.GetResultService.Request(goal_id=goal_handle.goal_id)
        future = self._result_client._call_async(request, is_repeatable=True)

        def keep_status(done: Future[Any]) -> None:
            if done._exception is None and done._result is not None:
                goal_handle._status = done._result.status
            self._feedback_callbacks.pop(bytes(goal_handle.goal_id.uuid), None)

        future.add_done_callback(keep_status)
        return future

    def server_is_ready(self) -> bool:
        """Whether a server with all its parts is up, and requests would find their way there."""
        clients = (self._send_client, self._cancel_client, self._result_client)
        return self._is_announced() and all(client._is_reached() for client in clients)

    def _is_announced(self) -> bool:
        graph = self._node.context._graph
        return all(
            graph.endpoints(endpoint._name, kind)
            for endpoint, kind in (
                (self._send_client, EntityKind.SERVICE),
                (self._cancel_client, EntityKind.SERVICE),
                (self._result_client, EntityKind.SERVICE),
                (self._feedback, EntityKind.PUBLISHER),
                (self._status, EntityKind.PUBLISHER),
            )
        )

    def wait_for_server(self, timeout_sec: float | None = None) -> bool:
        """Wait for a server; return whether it is there."""
        context = self._node.context
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        while context.ok():
            if self.server_is_ready():
                return True
            left = 0.1 if end is None else min(0.1, end - time.monotonic())
            if left <= 0:
                return False
            if context._graph.wait(self._is_announced, left):
                time.sleep(min(REACH_PERIOD_S, left))
        return False

    def destroy(self) -> None:
        """Withdraw."""
        for endpoint in self._endpoints:
            endpoint.destroy()
        self._node.remove_waitable(self)
