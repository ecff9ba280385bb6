# SPDX-License-Identifier: Apache-2.0
"""Subscriptions."""

from __future__ import annotations

import collections
import inspect
import struct
import threading
import time
from enum import Enum
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

from rclpy.endpoint import Endpoint, full_type_name

from embedded_ros import limits, wire
from embedded_ros.errors import CdrError, needs_ros2
from embedded_ros.graph import incompatible_policy
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh
    from rclpy.callback_groups import CallbackGroup
    from rclpy.event_handler import EventHandler, SubscriptionEventCallbacks
    from rclpy.node import Node
    from rclpy.qos import QoSProfile


#: [B] Samples that are not counted: as many of them as the queue is deep may wait.
_SMALL = 4096
#: Publishers that are remembered at a time.
_MAX_PUBLISHERS = 1024
_CDR_HEADER_BYTES = 4


class MessageInfo(TypedDict):
    """What a callback of two arguments gets beside the message; times are of the wall clock [ns since the epoch]."""

    source_timestamp: int
    received_timestamp: int
    publication_sequence_number: int | None
    reception_sequence_number: int | None
    publisher_gid: NotRequired[bytes]  # not in ROS 2 Jazzy


class Subscription(Endpoint):
    """Made by ``Node.create_subscription``."""

    class CallbackType(Enum):
        """What the callback takes."""

        MessageOnly = 0
        WithMessageInfo = 1

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
        *,
        raw: bool,
        event_callbacks: SubscriptionEventCallbacks,
        name: str | None = None,
    ) -> None:
        """Make it on a topic as its user calls it; ``name`` is the fully qualified name when that is another."""
        super().__init__(node, EntityKind.SUBSCRIPTION, name or topic, msg_type, qos_profile)
        self.topic = topic
        self.msg_type = msg_type
        self.raw = raw
        self.callback_group = callback_group
        self._executor_event = False
        self._runs_on_arrival = False
        self._callback_type = self.CallbackType.MessageOnly
        self._callback: Callable[..., Any] = callback
        self.callback = callback
        depth = None if self._wire_qos.history == 2 else max(1, self._wire_qos.depth)
        self._queue: collections.deque[tuple[bytes, bytes, int]] = collections.deque(maxlen=depth)
        self._max_bytes = limits.max_bytes(full_type_name(msg_type), "message")
        self._waiting_bytes = 0  # of the samples in the queue that are not small
        self._bytes_lock = threading.Lock()
        self._accepted: dict[bytes, bool] = {}
        self._last: dict[bytes, int] = {}
        self.event_handlers: list[EventHandler] = event_callbacks.create_event_handlers(callback_group, self, topic)
        self._subscriber = self._link.subscription(self._key, self._wire_qos, self._on_sample)
        self._announce()

    @property
    def callback(self) -> Callable[..., Any]:
        """What is called with each message."""
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any]) -> None:
        signature = inspect.signature(value)
        if _takes(signature, 1):
            self._callback_type = self.CallbackType.MessageOnly
        elif _takes(signature, 2):
            self._callback_type = self.CallbackType.WithMessageInfo
        else:
            raise RuntimeError(
                "Subscription.__init__(): callback should be either be callable with one argument "
                "(to get only the message) or two (to get message and message info)"
            )
        self._callback = value

    def _on_sample(self, sample: zenoh.Sample) -> None:
        """Take a sample in; runs on Zenoh's thread."""
        attachment = sample.attachment
        if attachment is None:
            return  # rmw_zenoh drops those too: nobody of ROS 2 sends them
        payload = sample.payload
        size = len(payload)
        if len(attachment) != wire.ATTACHMENT_BYTES or not _CDR_HEADER_BYTES <= size <= self._max_bytes:
            self._drop(
                f"expected {self._max_bytes} bytes at most and an attachment, found {size} and {len(attachment)}"
            )
            return
        data = attachment.to_bytes()
        accepted = self._accepted.get(data[17:])
        if accepted is None:
            accepted = self._accept(data[17:])
        if not accepted:
            return
        queue = self._queue
        waiting = len(queue)
        if waiting == queue.maxlen:
            self._forget_oldest()
        if size > _SMALL:
            self._count(size)
        # A copy: Zenoh's own payload keeps the whole buffer that it came in, 64 KiB for a message of 30 bytes.
        queue.append((payload.to_bytes(), data, time.time_ns()))
        # The executor may have emptied the queue in between: then it does not look for this one.
        if self._runs_on_arrival:
            self._run_waiting()
        elif not waiting or len(queue) == 1:
            self._node._rcl_ready(self)

    def _run_on_arrival(self) -> None:
        """From now on, run the callback on Zenoh's thread as a sample arrives, without the executor."""
        self._runs_on_arrival = True

    def _run_waiting(self) -> None:
        taken = self._take()
        if taken is not None:
            callback, arguments = taken
            callback(*arguments)

    def _accept(self, gid: bytes) -> bool:
        """Whether DDS would deliver from this publisher; not remembered until its token is seen."""
        publisher = self._node.context._graph.by_gid(gid)
        if publisher is None:
            return True
        accepted = incompatible_policy(publisher.qos, self._wire_qos) is None
        if len(self._accepted) >= _MAX_PUBLISHERS:
            self._accepted.clear()
        self._accepted[gid] = accepted
        return accepted

    def _count(self, size: int) -> None:
        """Make room for a large sample: all that wait together are no longer than one may be."""
        while self._waiting_bytes + size > self._max_bytes and self._queue:
            self._forget_oldest()
        with self._bytes_lock:
            self._waiting_bytes += size

    def _forget_oldest(self) -> None:
        try:
            payload, _, _ = self._queue.popleft()
        except IndexError:
            return  # it has just been taken
        self._uncount(payload)
        self._lost(1)

    def _uncount(self, payload: bytes) -> None:
        if (size := len(payload)) > _SMALL:
            with self._bytes_lock:
                self._waiting_bytes -= size

    def _drop(self, reason: str) -> None:
        held = self._node._rcl_throttle.admit(self)
        if held is not None:
            more = f" ({held} more since the last line)" if held else ""
            self._node.get_logger().error(f"dropped a sample on '{self._name}': {reason}{more}")

    def _lost(self, count: int) -> None:
        for handler in self.event_handlers:
            handler._on_lost(count)

    def _is_ready(self) -> bool:
        return bool(self._queue)

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        try:
            payload, attachment, received_ns = self._queue.popleft()
        except IndexError:
            return None
        self._uncount(payload)
        if self._queue:
            self._node._rcl_ready(self)
        try:
            sequence, stamp_ns, gid = wire.decode_attachment(attachment)
            message = payload if self.raw else self.msg_type.DEFINITION.deserialize(payload)
        except (CdrError, struct.error, ValueError) as error:
            self._drop(str(error))
            return None
        last = self._last.get(gid, 0)
        if sequence > last:
            if not last and len(self._last) >= _MAX_PUBLISHERS:
                self._last.clear()
            self._last[gid] = sequence
            if last and sequence > last + 1:
                self._lost(sequence - last - 1)
        if self._callback_type is self.CallbackType.MessageOnly:
            return self._callback, (message,)
        info: MessageInfo = {
            "source_timestamp": stamp_ns,
            "received_timestamp": received_ns,
            "publication_sequence_number": sequence,
            "reception_sequence_number": None,
            "publisher_gid": gid,
        }
        return self._callback, (message, info)

    @property
    def is_cft_enabled(self) -> bool:
        """Whether a content filter is at work: none is here."""
        return False

    def set_content_filter(self, *_: object, **__: object) -> None:
        """Refused."""
        raise needs_ros2("a content filter")

    get_content_filter = set_content_filter

    def get_publisher_count(self) -> int:
        """Return how many publishers reach this subscription."""
        return len(self._matched(EntityKind.PUBLISHER))

    @property
    def topic_name(self) -> str:
        """The fully qualified name."""
        return self._name

    def _undeclare(self) -> None:
        del self._subscriber  # see Link.subscription


def _takes(signature: inspect.Signature, count: int) -> bool:
    try:
        signature.bind(*[None] * count)
    except TypeError:
        return False
    return True
