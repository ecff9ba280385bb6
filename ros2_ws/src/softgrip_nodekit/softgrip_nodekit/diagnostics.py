# SPDX-License-Identifier: Apache-2.0
"""/diagnostics at 1 Hz: one status per component of a node, kept until replaced."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from softgrip_nodekit.qos import RELIABLE


class Health(IntEnum):
    """Level of a component (diagnostic_msgs/DiagnosticStatus)."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Diagnostics:
    """Publishes the health of a node's components.

    Args:
        node: the node that owns them.
        hardware_id: serial or name of the device behind the node, empty for none.
        period: [s] between messages; a change of level is published at once.
    """

    def __init__(self, node: Node, hardware_id: str = "", period: float = 1.0) -> None:
        self._node = node
        self._hardware_id = hardware_id
        self._components: dict[str, tuple[Health, str, dict[str, str]]] = {}
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._timer = node.create_timer(period, self.publish)

    def set(self, component: str, health: Health, message: str, values: Mapping[str, object] | None = None) -> None:
        """Set a component's health; ``message`` says what is wrong in words and what to do."""
        before = self._components.get(component)
        self._components[component] = (health, message, {k: str(v) for k, v in (values or {}).items()})
        if before is None or before[0] != health:
            if health >= Health.ERROR:
                self._node.get_logger().error(f"{component}: {message}")
            elif health == Health.WARN:
                self._node.get_logger().warning(f"{component}: {message}")
            self.publish()

    def publish(self) -> None:
        """Publish the present health of every component."""
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=bytes([health]),
                name=f"{self._node.get_name()}: {component}",
                message=message,
                hardware_id=self._hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for component, (health, message, values) in self._components.items()
        ]
        self._publisher.publish(array)
