# SPDX-License-Identifier: Apache-2.0
"""Clients of services."""

from __future__ import annotations

import collections
import dataclasses
import struct
import threading
import time
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rclpy.endpoint import Endpoint, full_type_name
from rclpy.task import Future

from embedded_ros import limits, wire
from embedded_ros.errors import CdrError, RequestRefusedError, needs_ros2
from embedded_ros.messages import deserialize, serialize
from embedded_ros.session import Link
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

RequestT = TypeVar("RequestT")
ResponseT = TypeVar("ResponseT")

_MAX_REASON = 4096  # [B]
REACH_PERIOD_S = 0.001  # between looks whether Zenoh has a way to what a token has announced
_AGAIN_PERIOD_S, _AGAIN_LIMIT_S = 0.2, 60.0  # looks whether a server is there again, and when that is given up


@dataclasses.dataclass
class _Question:
    """A request that is on its way; `servers` are those that may be asked again, none for one that is sent once."""

    sequence: int
    payload: bytearray
    attachment: bytes
    servers: frozenset[tuple[str, int]]
    is_answered: bool = False


class Client(Endpoint, Generic[RequestT, ResponseT]):
    """Made by ``Node.create_client``."""

    def __init__(
        self, node: Node, srv_type: Any, srv_name: str, qos_profile: QoSProfile, callback_group: CallbackGroup
    ) -> None:
        super().__init__(node, EntityKind.CLIENT, srv_name, srv_type, qos_profile)
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback_group = callback_group
        self._executor_event = False
        self._sequence = 0
        self._pending: dict[int, Future[ResponseT]] = {}
        self._lock = threading.Lock()
        self._max_bytes = limits.max_bytes(full_type_name(srv_type) + "_Response", "message")
        self._replies: collections.deque[tuple[int, bytes | Exception]] = collections.deque()
        self._querier = self._link.querier(self._key)
        self._announce()

    @property
    def context(self) -> Any:
        """The context of the node."""
        return self._node.context

    @property
    def service_name(self) -> str:
        """The fully qualified name."""
        return self._name

    def call(self, request: RequestT, timeout_sec: float | None = None) -> ResponseT | None:
        """Call and wait; another thread must spin the node. Return the response, or None when time is up."""
        if not isinstance(request, self.srv_type.Request):
            raise TypeError(f"expected {self.srv_type.Request}, found {type(request)}")
        done = threading.Event()
        future = self.call_async(request)
        future.add_done_callback(lambda _: done.set())
        with self._node.context._waking(done):
            # The future may be done without its executor running its callbacks: then nobody else spins.
            if not done.wait(timeout_sec):
                self.remove_pending_request(future)
                return None
        return future.result()

    def call_async(self, request: RequestT) -> Future[ResponseT]:
        """Call; the future ends with the response."""
        return self._call_async(request)

    def _call_async(self, request: RequestT, *, is_repeatable: bool = False) -> Future[ResponseT]:
        """Call; where asking twice does no harm, a question that was lost with its way is asked again."""
        if not isinstance(request, self.srv_type.Request):
            raise TypeError(f"expected {self.srv_type.Request}, found {type(request)}")
        self._alive()
        payload = serialize(request)
        future: Future[ResponseT] = Future(executor=self._node.executor)
        with self._lock:
            self._sequence += 1
            sequence = self._sequence
            self._pending[sequence] = future
        # At once and not through the executor: one round less for each call.
        future._add_waker(lambda: self._pending.pop(sequence, None))
        attachment = wire.encode_attachment(sequence, time.time_ns(), self._gid)
        self._ask(_Question(sequence, payload, attachment, self._servers() if is_repeatable else frozenset()))
        return future

    def _ask(self, question: _Question) -> None:
        def on_reply(reply: zenoh.Reply) -> None:
            if question.sequence in self._pending and (answer := self._answer(reply)) is not None:
                question.is_answered = True
                self._replies.append((question.sequence, answer))
                self._node._rcl_ready(self)

        def at_end() -> None:
            if question.servers and not question.is_answered:
                self._ask_again_later(question, time.monotonic() + _AGAIN_LIMIT_S)

        Link.ask(self._querier, question.payload, question.attachment, on_reply, at_end)

    def _ask_again_later(self, question: _Question, until_s: float) -> None:
        timer = threading.Timer(_AGAIN_PERIOD_S, self._ask_again, (question, until_s))
        timer.daemon = True
        timer.start()

    def _ask_again(self, question: _Question, until_s: float) -> None:
        """Ask once more when one of those asked is there again; another in its place knows nothing of it."""
        is_pending = question.sequence in self._pending and not self._destroyed and self._node.context.ok()
        if not is_pending or time.monotonic() > until_s:
            return
        if question.servers & self._servers() and self._is_reached():
            self._ask(question)
        else:
            self._ask_again_later(question, until_s)

    def _servers(self) -> frozenset[tuple[str, int]]:
        """Return the servers that are announced, each by its session and its number there."""
        servers = self._node.context._graph.endpoints(self._name, EntityKind.SERVICE)
        return frozenset((server.zid, server.entity_id) for server in servers)

    def _answer(self, reply: zenoh.Reply) -> bytes | Exception | None:
        """Return the CDR of a response, or why there is none; None while another answer may come."""
        sample, error = reply.ok, reply.err
        if sample is not None:
            if len(sample.payload) > self._max_bytes:
                text = f"expected a response of {self._max_bytes} bytes at most, found {len(sample.payload)}"
                return RequestRefusedError(f"'{self._name}': {text}")
            return sample.payload.to_bytes()
        if error is None or len(error.payload) > _MAX_REASON:
            return None
        return RequestRefusedError(error.payload.to_bytes().decode(errors="replace"))

    def _is_ready(self) -> bool:
        return bool(self._replies)

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        try:
            sequence, payload = self._replies.popleft()
        except IndexError:
            return None
        with self._lock:
            future = self._pending.get(sequence)
        if future is None or future._pending_is_over():
            return None
        future._set_executor(self._node.executor)
        if isinstance(payload, Exception):
            return future.set_exception, (payload,)
        try:
            response = deserialize(payload, self.srv_type.Response)
        except (CdrError, struct.error) as error:
            return future.set_exception, (RequestRefusedError(f"'{self._name}': malformed response: {error}"),)
        return future.set_result, (response,)

    def remove_pending_request(self, future: Future[ResponseT]) -> None:
        """Forget a call."""
        with self._lock:
            for sequence, pending in self._pending.items():
                if pending is future:
                    del self._pending[sequence]
                    break

    def service_is_ready(self) -> bool:
        """Whether a server of this name and type is up, and a request would find its way there."""
        return self._is_announced() and self._is_reached()

    def _is_announced(self) -> bool:
        servers = self._node.context._graph.endpoints(self._name, EntityKind.SERVICE)
        return any(server.type == self._entity.type for server in servers)

    def _is_reached(self) -> bool:
        """Whether Zenoh has a way to a server: a token may come a moment before what it stands for."""
        return not self._destroyed and bool(self._querier.matching_status.matching)

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait for a server; return whether it is there."""
        context = self._node.context
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        while context.ok() and not self._destroyed:
            # Short waits: a shutdown must not be held up by a graph that does not change.
            left = 0.1 if end is None else min(0.1, end - time.monotonic())
            if self.service_is_ready():
                return True
            if left <= 0:
                return False
            if context._graph.wait(self._is_announced, left):
                time.sleep(min(REACH_PERIOD_S, left))
        return self.service_is_ready() if context.ok() else False

    def configure_introspection(self, *_: object) -> None:
        """Refuse: service events are outside the scope."""
        raise needs_ros2("service introspection")

    def _undeclare(self) -> None:
        self._querier.undeclare()
