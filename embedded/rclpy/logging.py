# SPDX-License-Identifier: Apache-2.0
"""Loggers by name and their levels."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.impl import rcutils_logger
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.impl.rcutils_logger import RcutilsLogger

__all__ = [
    "LoggingSeverity", "clear_config", "get_logger", "get_logger_effective_level", "get_logger_level",
    "get_logging_directory", "get_logging_severity_from_string", "initialize", "set_logger_level", "shutdown",
]  # fmt: skip

_root_logger = RcutilsLogger()


def get_logger(name: str) -> RcutilsLogger:
    """Return the logger of a name."""
    if not name:
        raise ValueError("Logger name must not be empty.")
    return _root_logger.get_child(name)


def initialize() -> None:
    """Nothing to prepare here."""


def shutdown() -> None:
    """Nothing to give back here."""


def clear_config() -> None:
    """Forget all levels."""
    rcutils_logger.clear()


def set_logger_level(name: str, level: int | LoggingSeverity, detailed_error: bool = False) -> bool:  # noqa: ARG001
    """Set the level of a logger."""
    rcutils_logger.set_level(name, LoggingSeverity(level))
    return True


def get_logger_effective_level(name: str) -> LoggingSeverity:
    """Return the level that applies to a logger."""
    return rcutils_logger.effective_level(name)


def get_logger_level(name: str) -> LoggingSeverity:
    """Return the level set for this very logger."""
    return rcutils_logger.level_of(name)


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """Return the severity of a word such as ``INFO``."""
    if log_severity.upper() not in LoggingSeverity.__members__:
        raise RuntimeError(f"expected one of {', '.join(LoggingSeverity.__members__)}, found {log_severity!r}")
    return LoggingSeverity[log_severity.upper()]


def get_logging_directory() -> Path:
    """Return where ROS 2 keeps log files."""
    if found := os.environ.get("ROS_LOG_DIR"):
        return Path(found)
    home = os.environ.get("ROS_HOME")
    return (Path(home) if home else Path.home() / ".ros") / "log"
