# SPDX-License-Identifier: Apache-2.0
"""Small things that need no node: the default context, whether ROS is up, command lines without ROS arguments."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING

from rclpy.constants import S_TO_NS

if TYPE_CHECKING:
    from rclpy.context import Context

g_default_context: Context | None = None
g_context_lock = threading.Lock()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """Return the default context, making it when there is none (or a fresh one after a shutdown)."""
    global g_default_context  # noqa: PLW0603  the one global state of rclpy
    from rclpy.context import Context  # noqa: PLC0415  context imports this module

    with g_context_lock:
        if g_default_context is None:
            g_default_context = Context()
        context = g_default_context
        if shutting_down:
            g_default_context = None
        return context


def ok(*, context: Context | None = None) -> bool:
    """Whether ``rclpy.init()`` was called and no shutdown since."""
    return (context or get_default_context()).ok()


def shutdown(*, context: Context | None = None) -> None:
    """Shut a context down."""
    _release(context).shutdown()


def try_shutdown(*, context: Context | None = None) -> None:
    """Shut a context down unless it is already."""
    context = context or g_default_context
    if context is not None:
        _release(context).try_shutdown()


def _release(context: Context | None) -> Context:
    if context is None or context is g_default_context:
        return get_default_context(shutting_down=True)
    return context


def remove_ros_args(args: list[str] | None = None) -> list[str]:
    """Return a command line without its ROS arguments."""
    result = []
    inside = False
    for item in args if args is not None else sys.argv:
        if item == "--ros-args":
            inside = True
        elif inside and item == "--":
            inside = False
        elif not inside:
            result.append(item)
    return result


def timeout_sec_to_nsec(timeout_sec: float | None) -> int:
    """Return nanoseconds; -1 for None and for negative seconds (wait for ever)."""
    if timeout_sec is None or timeout_sec < 0:
        return -1
    return int(float(timeout_sec) * S_TO_NS)


def get_rmw_implementation_identifier() -> str:
    """Return the name of what carries the messages; it speaks rmw_zenoh_cpp's protocol."""
    return "rmw_zenoh_cpp"
