# SPDX-License-Identifier: Apache-2.0
"""Publishers."""

from __future__ import annotations

import itertools
import threading
import time
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.endpoint import Endpoint

from embedded_ros import wire
from embedded_ros.messages import serialize
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.duration import Duration
    from rclpy.event_handler import EventHandler, PublisherEventCallbacks
    from rclpy.node import Node
    from rclpy.qos import QoSProfile


class Publisher(Endpoint):
    """Made by ``Node.create_publisher``."""

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile,
        event_callbacks: PublisherEventCallbacks,
        callback_group: CallbackGroup,
        *,
        name: str | None = None,
    ) -> None:
        """Make it on a topic as its user calls it; ``name`` is the fully qualified name when that is another."""
        super().__init__(node, EntityKind.PUBLISHER, name or topic, msg_type, qos_profile)
        self.topic = topic
        self.msg_type = msg_type
        self._numbers = itertools.count(1)
        self._turn = threading.Lock()
        self._publisher = self._link.publisher(self._key, self._wire_qos)
        self.event_handlers: list[EventHandler] = event_callbacks.create_event_handlers(callback_group, self, topic)
        self._announce()

    def publish(self, msg: Any) -> None:
        """Publish a message, or bytes that hold its CDR.

        Raises:
            TypeError: it is no message of the topic's type, or a field has the wrong type.
        """
        if isinstance(msg, self.msg_type):
            payload: bytes | bytearray = serialize(msg)
        elif isinstance(msg, bytes):
            payload = msg
        else:
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        # In the order of their numbers, whichever thread publishes: out of order one looks lost to who counts.
        with self._turn:
            self._alive()
            if not self._node.context._ok:
                raise RCLError("Failed to publish: publisher's context is invalid")
            attachment = wire.encode_attachment(next(self._numbers), time.time_ns(), self._gid)
            self._publisher.put(payload, attachment=attachment)

    def get_subscription_count(self) -> int:
        """Return how many subscriptions this publisher reaches."""
        return len(self._matched(EntityKind.SUBSCRIPTION))

    @property
    def topic_name(self) -> str:
        """The fully qualified name."""
        return self._name

    def wait_for_all_acked(self, timeout: Duration | None = None) -> bool:  # noqa: ARG002
        """Return True: Zenoh's links are reliable and in order, nothing is left to acknowledge."""
        return True

    def _undeclare(self) -> None:
        with self._turn:
            del self._publisher  # see Link.publisher
