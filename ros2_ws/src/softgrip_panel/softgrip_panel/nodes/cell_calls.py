# SPDX-License-Identifier: Apache-2.0
"""Does acts: each is one service or action of the cell, called from the web's event loop, answered by the executor."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, TypeVar

from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.node import Node

from softgrip_panel.model.acts import Act, ActResult, CallKind
from softgrip_panel.nodes.convert import answer_of, request_message, ros_type
from softgrip_panel.texts import say

if TYPE_CHECKING:
    from rclpy.action.client import ClientGoalHandle
    from rclpy.client import Client
    from rclpy.task import Future
    from rclpy.type_support import FeedbackMessage

Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")

#: Called with the name of an act, what came, and who ordered it.
Hook = Callable[[str, Any, str], object]
#: [s] A server that is not there after so long is named as missing.
SERVER_WAIT_S: Final = 2.0
#: [s] An action server that has not taken a goal after so long is said to be silent.
GOAL_WAIT_S: Final = 10.0
#: Actions that run one goal at a time, whoever asked for it; tendon/move is also others'.
SOLE_ACTIONS: Final = frozenset({"cell/grasp", "cell/swap", "rig/calibrate"})
#: [s] after which a stop without an answer is asked for again
REPEAT_S: Final = 0.5
_POLL_S: Final = 0.02


class RosCalls:
    """The way to the cell.

    Args:
        node: makes the clients.
        on_accepted: called with act, goal, the 16 bytes of its identity, and person when an action takes a goal.
        on_feedback: called with each feedback.
        read_result: act, result -> success and words of an action.
    """

    def __init__(
        self,
        node: Node,
        on_accepted: Callable[[str, Any, bytes, str], object],
        on_feedback: Hook,
        read_result: Callable[[str, Any], tuple[bool, str]],
    ) -> None:
        self._node = node
        self._on_accepted = on_accepted
        self._on_feedback = on_feedback
        self._read_result = read_result
        self._service_clients: dict[str, Client[Any, Any]] = {}
        self._action_clients: dict[str, ActionClient[Any, Any, Any]] = {}
        self._goals: dict[str, ClientGoalHandle[Any, Any, Any]] = {}
        self._cancel_clients: dict[str, Client[CancelGoal.Request, CancelGoal.Response]] = {}

    def prepare(self, act: Act) -> None:
        """Make the client of an act now, so that its first call need not."""
        self._client(act)

    async def call(self, act: Act, who: str) -> ActResult:
        """Do an act and wait for what comes of it."""
        started_s = time.monotonic()
        try:
            success, message, answer = await self._called(act, who)
        except Exception as error:  # noqa: BLE001  whatever rclpy says is an answer for the person
            success, message, answer = False, f"{type(error).__name__}: {error}", None
        return ActResult(success, message, time.monotonic() - started_s, answer)

    def prepare_cancel(self, act: Act) -> None:
        """Make it possible to end a goal that another process sent, or this one's predecessor."""
        if act.call.name in SOLE_ACTIONS:
            service = f"{act.call.name}/_action/cancel_goal"
            self._cancel_clients[act.name] = self._node.create_client(CancelGoal, service)

    def cancel(self, act_name: str) -> None:
        """Ask for the end of a running action."""
        client, goal = self._cancel_clients.get(act_name), self._goals.get(act_name)
        if client is not None and client.service_is_ready():
            client.call_async(CancelGoal.Request())  # without an identity and a time: every goal (action_msgs)
        elif goal is not None:
            goal.cancel_goal_async()

    async def _called(self, act: Act, who: str) -> tuple[bool, str, Any]:
        client, kind = self._client(act)
        is_ready = client.service_is_ready if act.call.kind is CallKind.SERVICE else client.server_is_ready
        if not await wait_until(is_ready, SERVER_WAIT_S):
            return False, say("error.no_cell", name=act.call.name, wait=SERVER_WAIT_S), None
        if act.call.kind is CallKind.SERVICE:
            return await self._call_service(act, client, request_message(kind.Request, act.call.request))
        return await self._run_action(act, client, request_message(kind.Goal, act.call.request), who)

    async def _call_service(
        self, act: Act, client: Client[Request, Response], request: Request
    ) -> tuple[bool, str, Any]:
        answered = await ask(client, request, act.timeout_s, REPEAT_S if act.is_urgent else act.timeout_s)
        if answered is None:
            return False, say("error.no_answer", name=act.call.name, wait=act.timeout_s), None
        response = answered.result()
        success, message = answer_of(response)
        return success, message or ("" if success else say("error.refused", name=act.call.name)), response

    async def _run_action(
        self, act: Act, client: ActionClient[Goal, Result, Feedback], goal: Goal, who: str
    ) -> tuple[bool, str, Any]:
        def on_feedback(message: FeedbackMessage[Feedback]) -> None:
            self._on_feedback(act.name, message.feedback, who)

        sent = client.send_goal_async(goal, feedback_callback=on_feedback)
        if not await wait_for_answer(sent, GOAL_WAIT_S):
            return False, say("error.goal_not_taken", name=act.call.name, wait=GOAL_WAIT_S), None
        handle = sent.result()
        if not handle.accepted:
            return False, say("error.goal_rejected", name=act.call.name), None
        self._goals[act.name] = handle
        self._on_accepted(act.name, goal, bytes(bytearray(handle.goal_id.uuid)), who)
        try:
            result = handle.get_result_async()
            if not await wait_for_answer(result, act.timeout_s):
                handle.cancel_goal_async()
                return False, say("error.goal_late", name=act.call.name, wait=act.timeout_s), None
            answer = result.result()
        finally:
            self._goals.pop(act.name, None)
        success, message = self._read_result(act.name, answer.result)
        return success, message, answer.result

    def _client(self, act: Act) -> tuple[Any, Any]:
        kind = ros_type(act.call.type_name)
        name = act.call.name
        if act.call.kind is CallKind.SERVICE:
            if name not in self._service_clients:
                self._service_clients[name] = self._node.create_client(kind, name)
            return self._service_clients[name], kind
        if name not in self._action_clients:
            self._action_clients[name] = ActionClient(self._node, kind, name)
        return self._action_clients[name], kind


async def wait_until(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until a condition holds, without holding up the web's event loop; whether it does in time."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        await asyncio.sleep(_POLL_S)
    return True


async def ask(
    client: Client[Request, Response], request: Request, timeout_s: float, repeat_s: float
) -> Future[Response] | None:
    """Ask, and again while no answer comes.

    Args:
        client: of a service.
        request: of it.
        timeout_s: longest wait [s].
        repeat_s: [s] between two requests.

    Returns:
        the future that is done first; None when time is up.
    """
    end_s = time.monotonic() + timeout_s
    asked: list[Future[Response]] = []
    answered = None
    while answered is None and (left_s := end_s - time.monotonic()) > 0.0:
        asked.append(client.call_async(request))
        await wait_for_answer(asked[-1], min(left_s, repeat_s))
        answered = next((future for future in asked if future.done()), None)
    for future in asked:
        if not future.done():
            client.remove_pending_request(future)
    return answered


async def wait_for_answer(future: Future[Any], timeout_s: float) -> bool:
    """Wait for a future of rclpy without holding up the web's event loop; whether it is done in time."""
    loop = asyncio.get_running_loop()
    done = asyncio.Event()

    def wake(_: object) -> None:
        loop.call_soon_threadsafe(done.set)

    future.add_done_callback(wake)
    try:
        await asyncio.wait_for(done.wait(), timeout_s)
    except TimeoutError:
        return bool(future.done())
    return True
