# SPDX-License-Identifier: Apache-2.0
"""QoS events: incompatible QoS, matched endpoints, lost messages."""

from __future__ import annotations

import collections
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from rclpy.logging import get_logger
from rclpy.qos import QoSPolicyKind
from rclpy.waitable import Waitable

from embedded_ros.errors import needs_ros2
from embedded_ros.graph import incompatible_policy
from embedded_ros.wire import Entity, EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.endpoint import Endpoint


class QoSPublisherEventType(IntEnum):
    """Events of publishers; the numbers are rcl's."""

    RCL_PUBLISHER_OFFERED_DEADLINE_MISSED = 0
    RCL_PUBLISHER_LIVELINESS_LOST = 1
    RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS = 2
    RCL_PUBLISHER_INCOMPATIBLE_TYPE = 3
    RCL_PUBLISHER_MATCHED = 4


class QoSSubscriptionEventType(IntEnum):
    """Events of subscriptions; the numbers are rcl's."""

    RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED = 0
    RCL_SUBSCRIPTION_LIVELINESS_CHANGED = 1
    RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS = 2
    RCL_SUBSCRIPTION_MESSAGE_LOST = 3
    RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE = 4
    RCL_SUBSCRIPTION_MATCHED = 5


class QoSIncompatibleInfo(NamedTuple):
    """How many endpoints do not match, and over which policy the last one."""

    total_count: int
    total_count_change: int
    last_policy_kind: QoSPolicyKind


class QoSMessageLostInfo(NamedTuple):
    """How many messages were lost."""

    total_count: int
    total_count_change: int


class MatchedInfo(NamedTuple):
    """How many endpoints match."""

    total_count: int
    total_count_change: int
    current_count: int
    current_count_change: int


QoSRequestedIncompatibleQoSInfo = QoSIncompatibleInfo
QoSOfferedIncompatibleQoSInfo = QoSIncompatibleInfo
QoSSubscriptionMatchedInfo = MatchedInfo
QoSPublisherMatchedInfo = MatchedInfo


class QoSCountInfo(NamedTuple):
    """How often something happened."""

    total_count: int
    total_count_change: int


QoSLivelinessLostInfo = QoSCountInfo
QoSRequestedDeadlineMissedInfo = QoSCountInfo
QoSOfferedDeadlineMissedInfo = QoSCountInfo
IncompatibleTypeInfo = QoSCountInfo


class QoSLivelinessChangedInfo(NamedTuple):
    """How many publishers are alive; no such event is raised here."""

    alive_count: int
    not_alive_count: int
    alive_count_change: int
    not_alive_count_change: int


class UnsupportedEventTypeError(NotImplementedError):
    """An event that the middleware does not detect; rmw_zenoh has no deadline and liveliness events either."""


class EventHandler(Waitable):
    """Watches the graph for one endpoint and calls back in the executor."""

    def __init__(
        self,
        *,
        callback_group: CallbackGroup,
        callback: Callable[[Any], None],
        event_type: IntEnum,
        endpoint: Endpoint,
    ) -> None:
        super().__init__(callback_group)
        self.callback = callback
        self.event_type = event_type
        self._endpoint = endpoint
        self._events: collections.deque[Any] = collections.deque()
        self._total = 0
        self._matched: set[Entity] = set()
        self._name = event_type.name
        self._is_publisher = isinstance(event_type, QoSPublisherEventType)
        graph = endpoint._node.context._graph
        kind = EntityKind.SUBSCRIPTION if self._is_publisher else EntityKind.PUBLISHER
        graph.listen(self._on_change)
        for other in graph.endpoints(endpoint._name, kind):
            self._on_change(other, True)

    def _on_change(self, other: Entity, appeared: bool) -> None:
        kind = EntityKind.SUBSCRIPTION if self._is_publisher else EntityKind.PUBLISHER
        mine = self._endpoint._entity
        if other.kind is not kind or other.name != mine.name or other.type != mine.type:
            return
        offered, requested = (mine.qos, other.qos) if self._is_publisher else (other.qos, mine.qos)
        policy = incompatible_policy(offered, requested)
        if self._name.endswith("INCOMPATIBLE_QOS"):
            if policy is not None and appeared and other not in self._matched:
                self._matched.add(other)
                self._total += 1
                kind_name = QoSPolicyKind[policy.removesuffix("_QOS_POLICY")]
                self._push(QoSIncompatibleInfo(self._total, 1, kind_name))
        elif self._name.endswith("MATCHED") and policy is None and appeared != (other in self._matched):
            (self._matched.add if appeared else self._matched.discard)(other)
            self._total += appeared
            self._push(MatchedInfo(self._total, int(appeared), len(self._matched), 1 if appeared else -1))

    def _on_lost(self, count: int) -> None:
        if self._name == "RCL_SUBSCRIPTION_MESSAGE_LOST":
            self._total += count
            self._push(QoSMessageLostInfo(self._total, count))

    def _push(self, event: Any) -> None:
        self._events.append(event)
        self._endpoint._node._rcl_wake()

    def _is_ready(self) -> bool:
        return bool(self._events)

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        try:
            return self.callback, (self._events.popleft(),)
        except IndexError:
            return None

    def destroy(self) -> None:
        """Stop watching."""
        self._endpoint._node.context._graph.unlisten(self._on_change)


QoSEventHandler = EventHandler


class _EventCallbacks:
    """Callbacks for events of one end of a topic, and the default warning where nobody asked for the event."""

    #: what a default warning says; {} is the topic
    _warning: str
    #: the events that the middleware has, by the callback that is asked for
    _kinds: ClassVar[dict[str, IntEnum]]

    def __init__(
        self,
        *,
        deadline: Callable[[Any], None] | None = None,
        liveliness: Callable[[Any], None] | None = None,
        incompatible_qos: Callable[[QoSIncompatibleInfo], None] | None = None,
        incompatible_type: Callable[[Any], None] | None = None,
        matched: Callable[[MatchedInfo], None] | None = None,
        use_default_callbacks: bool = True,
    ) -> None:
        self.deadline = deadline
        self.liveliness = liveliness
        self.incompatible_qos = incompatible_qos
        self.incompatible_type = incompatible_type
        self.matched = matched
        self.use_default_callbacks = use_default_callbacks

    def create_event_handlers(
        self, callback_group: CallbackGroup, endpoint: Endpoint, topic_name: str
    ) -> list[EventHandler]:
        """Return the handlers.

        Raises:
            UnsupportedEventTypeError: a callback for deadline or liveliness events.
        """
        for name in ("deadline", "liveliness"):
            if getattr(self, name) is not None:
                raise UnsupportedEventTypeError(str(needs_ros2(f"the {name} event")))
        callbacks = {name: getattr(self, name) for name in self._kinds}
        if self.incompatible_qos is None and self.use_default_callbacks:
            warning = self._warning.format(topic_name)

            def warn(event: QoSIncompatibleInfo) -> None:
                policy = event.last_policy_kind.name
                get_logger(endpoint.logger_name).warn(f"{warning} Last incompatible policy: {policy}")

            callbacks["incompatible_qos"] = warn
        return [
            EventHandler(callback_group=callback_group, callback=callback, event_type=kind, endpoint=endpoint)
            for name, kind in self._kinds.items()
            if (callback := callbacks[name]) is not None
        ]


class SubscriptionEventCallbacks(_EventCallbacks):
    """Callbacks for events of a subscription."""

    _warning = (
        "New publisher discovered on topic '{}', offering incompatible QoS. No messages will be received from it."
    )
    _kinds: ClassVar[dict[str, IntEnum]] = {
        "incompatible_qos": QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
        "message_lost": QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
        "matched": QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED,
    }

    def __init__(self, *, message_lost: Callable[[QoSMessageLostInfo], None] | None = None, **callbacks: Any) -> None:
        super().__init__(**callbacks)
        self.message_lost = message_lost


class PublisherEventCallbacks(_EventCallbacks):
    """Callbacks for events of a publisher."""

    _warning = "New subscription discovered on topic '{}', requesting incompatible QoS. No messages will be sent to it."
    _kinds: ClassVar[dict[str, IntEnum]] = {
        "incompatible_qos": QoSPublisherEventType.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS,
        "matched": QoSPublisherEventType.RCL_PUBLISHER_MATCHED,
    }
