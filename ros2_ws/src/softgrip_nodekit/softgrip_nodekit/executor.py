# SPDX-License-Identifier: Apache-2.0
"""What runs a node's callbacks.

rclpy's ordinary executor looks through everything a node has for each callback, and takes one message of each topic in
turn; for a node that hears thirty topics that is more work than the callbacks. Its events executor is told by the
middleware what is ready.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.context import Context
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node

from softgrip_nodekit.cell_time import is_simulated
from softgrip_nodekit.priority import Breather

if TYPE_CHECKING:
    from rclpy.subscription import MessageInfo

Message = TypeVar("Message")

#: rclpy whose events executor waits for services that are coroutines, too.
_EVENTS_SINCE = (7, 1, 11)


class _Breathing(Executor):
    """Takes a breath between callbacks where its thread is a real-time one (`Breather`).

    Not in simulated time: no serial port of a device is read there, and the time waits for whoever pauses.

    Args:
        node: that it is made for.
    """

    def __init__(self, node: Node, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._breather = None if is_simulated(node) else Breather()

    def _spin_once_impl(self, *args: Any, **kwargs: Any) -> None:
        if self._breather is not None:
            self._breather.take_breath()
        super()._spin_once_impl(*args, **kwargs)


class BreathingExecutor(_Breathing, SingleThreadedExecutor):
    """Runs callbacks in the thread that spins."""


class _BreathingPool(_Breathing, MultiThreadedExecutor):
    """Runs callbacks in a pool of threads."""


def make_executor(node: Node, threads: int = 1) -> Executor:
    """Return an executor for a node that is complete; it is not added yet."""
    if threads > 1:
        return _BreathingPool(node, num_threads=threads)
    # The embedded rclpy has one kind of executor, which is told, too, and refuses to have the other.
    try:
        experimental = importlib.import_module("rclpy.experimental")
    except (ModuleNotFoundError, NotImplementedError):
        return BreathingExecutor(node)
    # That one cannot wait for guard conditions.
    if _rclpy_version() < _EVENTS_SINCE or list(node.guards):
        return BreathingExecutor(node)
    events_executor: Executor = experimental.EventsExecutor()
    return events_executor


def with_message_info(callback: Callable[[Message, MessageInfo], None]) -> Callable[[Message, MessageInfo], None]:
    """Return a subscription's callback of message and message info that every executor can call.

    The events executor hands both over as one tuple; rclpy tells by the signature whether a callback wants them.
    """

    def taken(*arguments: Any) -> None:
        message, info = arguments if len(arguments) > 1 else arguments[0]
        callback(message, info)

    taken.__signature__ = inspect.signature(callback)  # type: ignore[attr-defined]
    return taken


def _rclpy_version() -> tuple[int, ...]:
    # 3 MB and 30 ms that only a real rclpy is worth
    from importlib import metadata  # noqa: PLC0415

    try:
        return tuple(int(part) for part in metadata.version("rclpy").split(".")[:3])
    except (metadata.PackageNotFoundError, ValueError):
        return ()


def destroy_node(node: Node) -> None:
    """Destroy a node with its actions, which rclpy leaves to whoever made them.

    While one of them is left the node stays in the middleware, and its threads run into the end of the process: the
    security plugins of Cyclone DDS then meet an OpenSSL that has been cleaned up, and end the process by SIGSEGV.
    """
    for waitable in list(node.waitables):
        if isinstance(waitable, ActionServer | ActionClient):
            waitable.destroy()
    node.destroy_node()


def end_context(context: Context | None = None) -> None:
    """Shut a context down if it is not down yet; None = the one that `rclpy.init` made.

    `try_shutdown` looks and then shuts down; where a signal's thread does so in between, rcl refuses the second
    time ("rcl_shutdown already called"). What is wanted has happened then, and the caller may have hardware to make
    safe.
    """
    with contextlib.suppress(RuntimeError):
        if context is None:
            rclpy.try_shutdown()
        else:
            context.try_shutdown()
