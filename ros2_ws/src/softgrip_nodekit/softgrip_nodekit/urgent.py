# SPDX-License-Identifier: Apache-2.0
"""Services that must be answered whatever else a node is busy with: the emergency stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar

from rclpy.node import Node

from softgrip_nodekit.callback_errors import callback_errors
from softgrip_nodekit.cell_time import steady_timer, time_waits_for
from softgrip_nodekit.isolated import IsolatedNode
from softgrip_nodekit.standstill import LOOK_PERIOD_S, Standstill

if TYPE_CHECKING:
    from softgrip_nodekit.node_io import ServiceType

Request = TypeVar("Request")
Response = TypeVar("Response")


class UrgentServer(Generic[Request, Response]):
    """Serve a service from a context, session, node, queue and thread of its own.

    Nothing that the node's executor does delays it: the node is called ``<name>_urgent``, lives in the same namespace
    and serves nothing else. The service's name is expanded and remapped as the node's own names are.

    A callback that raises is answered with ``success = False`` and the reason in ``message``, where the response has
    these fields; the error counts as one of the node's callbacks.

    Args:
        node: that the service belongs to.
        srv_type: of the service.
        name: of the service.
        callback: of (request, response), returns the response. It runs on the server's own thread, beside the node's
            callbacks: what both touch needs a lock.
        on_standstill: called on that thread, with the time [s], when the server itself has stood still (the process was
            stopped, swapped out, or suspended): what was asked meanwhile may be lost. Not in an emulated cell, whose
            time waits.
    """

    def __init__(
        self,
        node: Node,
        srv_type: ServiceType[Request, Response],
        name: str,
        callback: Callable[[Request, Response], Response],
        on_standstill: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._callback = callback
        self._errors = callback_errors(node)
        self._isolated = IsolatedNode(node, "urgent", self._errors.report)
        self.service_name = node.resolve_service_name(name)
        self._isolated.node.create_service(srv_type, self.service_name, self._serve)
        self._standstill, self._on_standstill = Standstill(), on_standstill
        steady_timer(self._isolated.node, LOOK_PERIOD_S, self._look)
        self._isolated.start()

    def _serve(self, request: Request, response: Response) -> Response:
        try:
            return self._callback(request, response)
        except Exception as error:  # noqa: BLE001  whoever asked must hear that it failed
            self._errors.report(error)
            if hasattr(response, "success"):
                response.success = False
            if hasattr(response, "message"):
                response.message = f"{type(error).__name__}: {error}"
            return response

    def _look(self) -> None:
        stood_s = self._standstill.measure_gap()
        if stood_s and not time_waits_for(self._node):
            self._on_standstill(stood_s)

    def close(self) -> None:
        """Answer what is being answered, then leave."""
        self._isolated.close()
