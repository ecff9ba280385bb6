# SPDX-License-Identifier: Apache-2.0
"""Servers of services."""

from __future__ import annotations

import collections
import struct
import threading
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.endpoint import Endpoint, full_type_name

from embedded_ros import limits, wire
from embedded_ros.errors import CdrError, needs_ros2
from embedded_ros.messages import deserialize, serialize
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.qos import QoSProfile


#: [B] Requests up to this are read when they arrive, so that garbage takes nobody's place in the queue.
_READ_AT_ONCE = 4096
#: [B] of requests that wait, beside the number of them.
_MAX_WAITING = 16 << 20


class RequestHeader(NamedTuple):
    """Which request a response answers."""

    query: zenoh.Query
    sequence: int
    gid: bytes


class Service(Endpoint):
    """Made by ``Node.create_service``."""

    def __init__(
        self,
        node: Node,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
    ) -> None:
        super().__init__(node, EntityKind.SERVICE, srv_name, srv_type, qos_profile)
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False
        self._depth = None if self._wire_qos.history == 2 else max(1, self._wire_qos.depth)
        self._max_bytes = limits.max_bytes(full_type_name(srv_type) + "_Request", "request")
        self._queue: collections.deque[tuple[Any, RequestHeader]] = collections.deque()
        self._waiting_bytes = 0  # of those that are not read yet
        self._lock = threading.Lock()
        self._queryable = self._link.queryable(self._key, self._on_query)
        self._announce()

    @property
    def service_name(self) -> str:
        """The fully qualified name."""
        return self._name

    def _on_query(self, query: zenoh.Query) -> None:
        """Take a request in, or refuse it; runs on Zenoh's thread. Those that wait already keep their places."""
        try:
            payload, header = self._check(query)
            request = self._read(payload) if len(payload) <= _READ_AT_ONCE else payload
        except (CdrError, struct.error, ValueError) as error:
            self._refuse(query, f"malformed: {error}")
            return
        size = len(request) if isinstance(request, bytes) else 0
        with self._lock:
            is_full = self._depth is not None and len(self._queue) >= self._depth
            if not is_full and self._waiting_bytes + size <= _MAX_WAITING:
                self._queue.append((request, header))
                self._waiting_bytes += size
                self._node._rcl_ready(self)
                return
            waiting = len(self._queue)
        self._refuse(query, f"busy: {waiting} requests are waiting; ask again later")

    def _check(self, query: zenoh.Query) -> tuple[bytes, RequestHeader]:
        """Return payload and header of a query that may be a request; ValueError or struct.error where it is none."""
        attachment, payload = query.attachment, query.payload
        if attachment is None or payload is None:
            raise ValueError("no attachment or no payload")
        if len(attachment) != wire.ATTACHMENT_BYTES:
            raise ValueError(f"expected an attachment of {wire.ATTACHMENT_BYTES} bytes, found {len(attachment)}")
        if len(payload) > self._max_bytes:
            raise ValueError(f"expected {self._max_bytes} bytes at most, found {len(payload)}")
        sequence, _, gid = wire.decode_attachment(attachment.to_bytes())
        return payload.to_bytes(), RequestHeader(query, sequence, gid)

    def _read(self, payload: bytes) -> Any:
        return deserialize(payload, self.srv_type.Request)

    def _refuse(self, query: zenoh.Query, reason: str) -> None:
        """Answer with an error, so that the client need not wait for an answer that never comes."""
        held = self._node._rcl_throttle.admit(self)
        if held is not None:
            more = f" ({held} more since the last line)" if held else ""
            self._node.get_logger().error(f"refused a request to '{self._name}': {reason}{more}")
        if not self._destroyed and self._node.context._ok:
            query.reply_err(f"'{self._name}': {reason}".encode())
        query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub

    def _is_ready(self) -> bool:
        return bool(self._queue)

    def _take_request(self) -> tuple[Any, RequestHeader] | None:
        """Return the oldest request and what its response needs; None when there is none, or it is garbage."""
        with self._lock:
            if not self._queue:
                return None
            request, header = self._queue.popleft()
            if isinstance(request, bytes):
                self._waiting_bytes -= len(request)
        if not isinstance(request, bytes):
            return request, header
        try:
            return self._read(request), header
        except CdrError as error:
            self._refuse(header.query, f"malformed: {error}")
            return None

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...], Callable[[Any], None]] | None:
        taken = self._take_request()
        if taken is None:
            return None
        request, header = taken

        def call(request: Any, response: Any) -> Any:
            try:
                return self.callback(request, response)
            except Exception as error:
                self._refuse(header.query, f"the callback failed: {type(error).__name__}: {error}")
                raise

        return call, (request, self.srv_type.Response()), lambda response: self.send_response(response, header)

    def send_response(self, response: Any, header: RequestHeader) -> None:
        """Answer a request."""
        if not isinstance(response, self.srv_type.Response):
            raise TypeError(
                f"the callback of '{self._name}' returned {type(response)}, expected {self.srv_type.Response}"
            )
        if self._destroyed or not self._node.context._ok:
            return
        attachment = wire.encode_attachment(header.sequence, time.time_ns(), header.gid)
        header.query.reply(self._key, serialize(response), attachment=attachment, express=True)
        header.query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub

    def configure_introspection(self, *_: object) -> None:
        """Refuse: service events are outside the scope."""
        raise needs_ros2("service introspection")

    def _undeclare(self) -> None:
        self._queryable.undeclare()
