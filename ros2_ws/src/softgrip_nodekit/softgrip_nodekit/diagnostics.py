# SPDX-License-Identifier: Apache-2.0
"""/diagnostics at 1 Hz: one status per component of a node, kept until replaced; and who has gone and comes back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from softgrip_nodekit.callback_errors import callback_errors
from softgrip_nodekit.cell_time import steady_timer
from softgrip_nodekit.qos import RELIABLE

if TYPE_CHECKING:
    from rclpy.subscription import Subscription

#: DDS tells of a publisher before it knows its node (rmw_dds_common, graph_cache.cpp).
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


class Presence:
    """Tells of names that disappear, and of those that come back; a name's first appearance is no news.

    Args:
        on_change: called with the name and whether it is there.
    """

    def __init__(self, on_change: Callable[[str, bool], None]) -> None:
        self._on_change = on_change
        self._there: set[str] = set()
        self._gone: set[str] = set()

    def update(self, names: Iterable[str]) -> None:
        """Take what is there now."""
        there = set(names)
        gone, back = self._there - there, self._gone & there
        self._there, self._gone = there, (self._gone | gone) - back
        for name in sorted(gone):
            self._on_change(name, False)
        for name in sorted(back):
            self._on_change(name, True)


def published_inputs(node: Node) -> list[str]:
    """Return the streams and states a node listens to that have a publisher.

    Streams are best effort and states are latched (docs/conventions.md); whoever sends commands may come and go.
    """
    watched = [subscription for subscription in node.subscriptions if _is_stream_or_state(subscription)]
    return [subscription.topic_name for subscription in watched if subscription.get_publisher_count() > 0]


def diagnosed_nodes(node: Node) -> list[str]:
    """Return the names of the nodes that report on /diagnostics: those of this cell, not those of tools or others."""
    own = node.get_namespace().rstrip("/")
    publishers = node.get_publishers_info_by_topic("/diagnostics")
    names = [
        f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
        for publisher in publishers
        if publisher.node_name != _UNKNOWN
    ]
    return [name for name in names if name.startswith(f"{own}/")]


def _is_stream_or_state(subscription: Subscription) -> bool:
    qos = subscription.qos_profile
    is_stream = qos.reliability == ReliabilityPolicy.BEST_EFFORT
    return bool(is_stream or qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)


#: [s] between looks at who is still there
PRESENCE_PERIOD = 0.2
#: [s] An executor that is later than this is said to be.
LATE_LIMIT_S = 1.0
#: A message that quotes what came from outside is as long as that.
MAX_CHARS = 2000


class Health(IntEnum):
    """Level of a component (diagnostic_msgs/DiagnosticStatus); STALE: nothing has come yet, and it is early."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Diagnostics:
    """Publishes the health of a node's components, and of those of its inputs that lost their publisher.

    A component ``executor`` is always there: how late callbacks were run since the last message, and how many raised.

    Args:
        node: the node that owns them.
        hardware_id: serial or name of the device behind the node; empty = the name of the cell.
        period: [s] between messages; a change of level is published at once.
        watch_nodes: also report the other nodes of the cell that are there no longer; one node of the cell does that.
    """

    def __init__(self, node: Node, hardware_id: str = "", period: float = 1.0, *, watch_nodes: bool = False) -> None:
        self._node = node
        # /diagnostics is one topic for all cells: the name tells whose it is.
        self._name = node.get_fully_qualified_name().strip("/")
        self._hardware_id = hardware_id or node.get_namespace().strip("/")
        self._components: dict[str, tuple[Health, str, dict[str, str]]] = {}
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._lock = threading.Lock()
        self._errors = callback_errors(node)
        self._looked = time.monotonic()
        self._late_s = 0.0  # the latest since the last message
        self._timer = steady_timer(node, period, self.publish)
        self._inputs = Presence(lambda topic, there: self._report_presence(f"input {topic}", there))
        self._nodes = Presence(lambda name, there: self._report_presence(f"node {name}", there))
        self._watch_nodes = watch_nodes
        self._presence_timer = steady_timer(node, PRESENCE_PERIOD, self._look_around)

    def set(self, component: str, health: Health, message: str, values: Mapping[str, object] | None = None) -> None:
        """Set a component's health; ``message`` says what is wrong in words and what to do."""
        texts = {k: str(v)[:MAX_CHARS] for k, v in (values or {}).items()}
        message = message[:MAX_CHARS]
        with self._lock:
            before = self._components.get(component)
            self._components[component] = (health, message, texts)
        if before is None or before[0] != health:
            if health == Health.ERROR:
                self._node.get_logger().error(f"{component}: {message}")
            elif health == Health.WARN:
                self._node.get_logger().warning(f"{component}: {message}")
            elif health == Health.STALE:
                self._node.get_logger().info(f"{component}: {message}")
            self.publish()

    def _look_around(self) -> None:
        now = time.monotonic()
        with self._lock:
            self._late_s = max(self._late_s, now - self._looked - PRESENCE_PERIOD)
        self._looked = now
        self._inputs.update(published_inputs(self._node))
        if self._watch_nodes:
            self._nodes.update(diagnosed_nodes(self._node))

    def _report_presence(self, component: str, there: bool) -> None:
        if there:
            self._node.get_logger().info(f"{component}: there again")
            self.set(component, Health.OK, "there again")
        else:
            self.set(component, Health.WARN, "gone: ended, dead, frozen or cut off; start it again if it was not meant")

    def publish(self) -> None:
        """Publish the present health of every component; any thread may."""
        with self._lock:
            components = {**self._components, "executor": self._executor_health()}
            self._late_s = 0.0
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=bytes([health]),
                name=f"{self._name}: {component}",
                message=message,
                hardware_id=self._hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for component, (health, message, values) in components.items()
        ]
        self._publisher.publish(array)

    def _executor_health(self) -> tuple[Health, str, dict[str, str]]:
        values = {"callback_errors": str(self._errors.count), "late_ms": f"{1000.0 * self._late_s:.0f}"}
        if self._late_s > LATE_LIMIT_S:
            return Health.WARN, f"callbacks were run {self._late_s:.1f} s late; see what takes so long", values
        if self._errors.is_recent():
            return Health.WARN, f"a callback failed, see the log: {self._errors.last}", values
        return Health.OK, "", values
