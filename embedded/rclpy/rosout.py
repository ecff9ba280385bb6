# SPDX-License-Identifier: Apache-2.0
"""Publishes what a node logs on /rosout."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rclpy._rclpy_pybind11 import RCLError
from rclpy.constants import S_TO_NS
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.impl import rcutils_logger
from rclpy.publisher import Publisher

from embedded_ros.later import LATER

if TYPE_CHECKING:
    from rcl_interfaces.msg import Log
    from rclpy.impl.rcutils_logger import CallerId
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

_SILENT = PublisherEventCallbacks(use_default_callbacks=False)


class Rosout:
    """The /rosout publisher of a node."""

    def __init__(self, node: Node, topic: str, profile: QoSProfile) -> None:
        from rcl_interfaces.msg import Log  # noqa: PLC0415  classes are made on first use

        self._context = node.context
        self._logger_name = node.get_logger().name
        self._publisher = Publisher(node, Log, topic, profile, _SILENT, node.default_callback_group)
        rcutils_logger.add_sink(self._logger_name, self._publish)

    def _publish(self, stamp_ns: float, severity: int, name: str, text: str, caller: CallerId) -> None:
        if not self._context._ok:
            return
        log = self._publisher.msg_type(
            level=int(severity), name=name, msg=text.encode(errors="replace").decode(), file=caller.file_path,
            function=caller.function_name, line=caller.line_number,
        )  # fmt: skip
        log.stamp.sec, log.stamp.nanosec = divmod(int(stamp_ns), S_TO_NS)
        LATER.run(lambda: self._send(log))

    def _send(self, log: Log) -> None:
        if self._context._ok:
            with contextlib.suppress(InvalidHandle, RCLError):  # gone while the line waited
                self._publisher.publish(log)

    def destroy(self) -> None:
        """Stop publishing."""
        rcutils_logger.remove_sink(self._logger_name, self._publish)
        self._publisher.destroy()
