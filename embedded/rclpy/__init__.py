# SPDX-License-Identifier: Apache-2.0
"""rclpy where there is no ROS 2: the part of its API that is listed in embedded/README.md."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Self

from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.signals import (
    SignalHandlerOptions,
    install_signal_handlers,
    register_context,
    uninstall_signal_handlers,
)
from rclpy.task import Future
from rclpy.utilities import get_default_context, get_rmw_implementation_identifier, ok

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.executors import Executor
    from rclpy.node import Node

__all__ = [
    "Future", "Parameter", "SignalHandlerOptions", "create_node", "get_default_context", "get_global_executor",
    "get_rmw_implementation_identifier", "init", "ok", "shutdown", "spin", "spin_once", "spin_until_future_complete",
    "try_shutdown",
]  # fmt: skip


class InitContextManager:
    """What ``init`` returns: ``with rclpy.init():`` shuts down at the end."""

    def __init__(self, context: Context, *, installed: bool) -> None:
        self.context = context
        self._installed = installed

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try_shutdown(context=self.context, uninstall_handlers=self._installed)


def init(
    *,
    args: list[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> InitContextManager:
    """Initialize a context (the default one unless given) and the signal handlers."""
    if signal_handler_options is None:
        signal_handler_options = SignalHandlerOptions.ALL if context is None else SignalHandlerOptions.NO
    context = context or get_default_context()
    context.init(args, domain_id=domain_id)
    register_context(context)
    install_signal_handlers(signal_handler_options)
    return InitContextManager(context, installed=signal_handler_options != SignalHandlerOptions.NO)


__executor: Executor | None = None


def get_global_executor() -> Executor:
    """Return the executor that ``spin`` uses when it is given none."""
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415  executors import this package

    global __executor  # noqa: PLW0603  as in rclpy
    if __executor is None:
        executor = SingleThreadedExecutor()
        executor.context.on_shutdown(_forget_executor)
        __executor = executor
    return __executor


def _forget_executor() -> None:
    global __executor  # noqa: PLW0603  as in rclpy
    __executor = None


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut a context down (the default one unless given)."""
    from rclpy import utilities  # noqa: PLC0415  the public name of this module hides it

    utilities.shutdown(context=context)
    if uninstall_handlers or (uninstall_handlers is None and context is None):
        uninstall_signal_handlers()


def try_shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut a context down unless that has happened."""
    from rclpy import utilities  # noqa: PLC0415  the public name of this module hides it

    utilities.try_shutdown(context=context)
    if uninstall_handlers or (uninstall_handlers is None and context is None):
        uninstall_signal_handlers()


def create_node(node_name: str, **kwargs: Any) -> Node:
    """Make a node; the arguments are those of :class:`rclpy.node.Node`."""
    from rclpy.node import Node  # noqa: PLC0415  nodes import this package

    return Node(node_name, **kwargs)


@contextlib.contextmanager
def _spun_by(node: Node, executor: Executor | None) -> Iterator[Executor]:
    executor = get_global_executor() if executor is None else executor
    added = executor.add_node(node)
    try:
        yield executor
    finally:
        if added:
            executor.remove_node(node)


def spin_once(node: Node, *, executor: Executor | None = None, timeout_sec: float | None = None) -> None:
    """Run one callback of a node."""
    with _spun_by(node, executor) as chosen:
        chosen.spin_once(timeout_sec=timeout_sec)


def spin(node: Node, executor: Executor | None = None) -> None:
    """Run callbacks of a node until its context is shut down."""
    with _spun_by(node, executor) as chosen:
        while chosen.context.ok():
            chosen.spin_once()


def spin_until_future_complete(
    node: Node,
    future: Future[Any],
    executor: Executor | None = None,
    timeout_sec: float | None = None,
) -> None:
    """Run callbacks of a node until a future is over or time is up."""
    with _spun_by(node, executor) as chosen:
        chosen.spin_until_future_complete(future, timeout_sec)
