# SPDX-License-Identifier: Apache-2.0
"""Servers of services."""

from __future__ import annotations

import collections
import struct
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.endpoint import Endpoint

from embedded_ros import wire
from embedded_ros.errors import CdrError, needs_ros2
from embedded_ros.messages import deserialize, serialize
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.qos import QoSProfile


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
        depth = None if self._wire_qos.history == 2 else max(1, self._wire_qos.depth)
        self._queue: collections.deque[zenoh.Query] = collections.deque(maxlen=depth)
        self._queryable = self._link.queryable(self._key, self._on_query)
        self._announce()

    @property
    def service_name(self) -> str:
        """The fully qualified name."""
        return self._name

    def _on_query(self, query: zenoh.Query) -> None:
        self._queue.append(query)
        self._node._rcl_ready(self)

    def _is_ready(self) -> bool:
        return bool(self._queue)

    def _take_request(self) -> tuple[Any, RequestHeader] | None:
        """Return the oldest request and what its response needs; None when there is none, or it is garbage."""
        try:
            query = self._queue.popleft()
        except IndexError:
            return None
        try:
            if query.attachment is None or query.payload is None:
                raise ValueError("no attachment or no payload")
            sequence, _, gid = wire.decode_attachment(query.attachment.to_bytes())
            return deserialize(query.payload.to_bytes(), self.srv_type.Request), RequestHeader(query, sequence, gid)
        except (CdrError, struct.error, ValueError) as error:
            self._node.get_logger().error(f"dropped a request to '{self._name}': {error}")
            query.drop()  # type: ignore[no-untyped-call]  # zenoh's stub
            return None

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...], Callable[[Any], None]] | None:
        taken = self._take_request()
        if taken is None:
            return None
        request, header = taken
        return self.callback, (request, self.srv_type.Response()), lambda response: self.send_response(response, header)

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
