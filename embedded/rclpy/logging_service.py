# SPDX-License-Identifier: Apache-2.0
"""The services ``~/get_logger_levels`` and ``~/set_logger_levels`` of nodes that enable them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy import logging
from rclpy.impl.logging_severity import LoggingSeverity

if TYPE_CHECKING:
    from rclpy.node import Node


class LoggingService:
    """Belongs to a node."""

    def __init__(self, node: Node) -> None:
        from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels  # noqa: PLC0415  classes are made on first use

        node.create_service(GetLoggerLevels, "~/get_logger_levels", self._get)
        node.create_service(SetLoggerLevels, "~/set_logger_levels", self._set)

    @staticmethod
    def _get(request: Any, response: Any) -> Any:
        from rcl_interfaces.msg import LoggerLevel  # noqa: PLC0415  classes are made on first use

        response.levels = [LoggerLevel(name=name, level=int(logging.get_logger_level(name))) for name in request.names]
        return response

    @staticmethod
    def _set(request: Any, response: Any) -> Any:
        from rcl_interfaces.msg import SetLoggerLevelsResult  # noqa: PLC0415  classes are made on first use

        for level in request.levels:
            try:
                logging.set_logger_level(level.name, LoggingSeverity(level.level))
                response.results.append(SetLoggerLevelsResult(successful=True))
            except ValueError:
                reason = "Failed reason: Invalid logger level."
                response.results.append(SetLoggerLevelsResult(successful=False, reason=reason))
        return response
