# SPDX-License-Identifier: Apache-2.0
"""A second node of a process that shares nothing with the first: context, session, executor and thread of its own."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softgrip_nodekit.executor import BreathingExecutor, end_context

if TYPE_CHECKING:
    from collections.abc import Callable

#: [s] for a callback that runs when the node is closed.
CLOSE_TIMEOUT_S = 2.0


class IsolatedNode:
    """Make a node beside another one, that no work of the other one can delay.

    The other node's namespace, domain and enclave are its own, too. Arguments of the process are not applied a second
    time: a ``__node:=`` would give both nodes one name. The other node resolves remapped names.

    Args:
        beside: the node that it belongs to.
        suffix: its name is the other node's name + "_" + suffix.
        on_error: called with each exception that a callback raised; the node goes on.
    """

    def __init__(self, beside: Node, suffix: str, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._context = Context()
        rclpy.init(args=_enclave_arguments(beside), context=self._context, domain_id=beside.context.get_domain_id())
        try:
            self.node = Node(
                f"{beside.get_name()}_{suffix}",
                namespace=beside.get_namespace(),
                context=self._context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[Parameter("start_type_description_service", value=False)],
            )
        except BaseException:
            end_context(self._context)
            raise
        self._executor = BreathingExecutor(beside, context=self._context)
        self._executor.add_node(self.node)
        self._is_closed = False
        self._thread = threading.Thread(target=self._spin, name=self.node.get_name(), daemon=True)

    def start(self) -> None:
        """Start to run callbacks; call this when everything that the node serves has been made."""
        self._thread.start()

    def _spin(self) -> None:
        while self._context.ok() and not self._is_closed:
            try:
                self._executor.spin()
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception as error:  # noqa: BLE001  nothing that a caller sends ends this thread
                if not self._is_closed and self._context.ok():
                    self._on_error(error)

    def close(self) -> None:
        """Stop, wait for a callback that runs, and leave the network; raises nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        with contextlib.suppress(Exception):  # after a signal rclpy has taken the context down, or is about to
            self._executor.shutdown(timeout_sec=CLOSE_TIMEOUT_S)
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(CLOSE_TIMEOUT_S)
        with contextlib.suppress(Exception):
            self.node.destroy_node()
        end_context(self._context)


def _enclave_arguments(node: Node) -> list[str]:
    """Return the arguments that give a context the enclave (SROS 2) of a node."""
    own = (node.get_name(), node.get_namespace())
    for name, namespace, enclave in node.get_node_names_and_namespaces_with_enclaves():
        if (name, namespace) == own and enclave not in {"", "/"}:
            return ["--ros-args", "--enclave", enclave]
    return []
