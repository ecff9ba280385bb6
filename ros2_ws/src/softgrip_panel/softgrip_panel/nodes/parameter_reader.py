# SPDX-License-Identifier: Apache-2.0
"""Reads the parameters of the cell's nodes: list, describe, get."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.node import Node

from softgrip_panel.errors import PanelError
from softgrip_panel.model.parameters import ParameterView
from softgrip_panel.nodes.cell_calls import SERVER_WAIT_S, wait_for_answer, wait_until
from softgrip_panel.nodes.convert import parameter_view
from softgrip_panel.texts import say

if TYPE_CHECKING:
    from rclpy.client import Client

    from softgrip_nodekit.node_io import ServiceType

Request = TypeVar("Request")
Response = TypeVar("Response")

#: A node that does not answer within this is named [s].
ANSWER_S: Final = 5.0
_SERVICE: Final = "/describe_parameters"


class RosParameters:
    """The way to the parameters of other nodes of this cell.

    Args:
        node: makes the clients.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, Client[Any, Any]] = {}

    def nodes(self) -> tuple[str, ...]:
        """Return the names of the cell's nodes that have parameters."""
        inside = self._node.get_namespace().rstrip("/") + "/"
        names = (name for name, _ in self._node.get_service_names_and_types() if name.endswith(_SERVICE))
        own = (name.removesuffix(_SERVICE).removeprefix(inside) for name in names if name.startswith(inside))
        return tuple(sorted(name for name in own if "/" not in name and not name.startswith("_")))

    async def read(self, node: str) -> tuple[ParameterView, ...]:
        """Return all parameters of a node.

        Raises:
            PanelError: there is no such node, or it does not answer.
        """
        if node not in self.nodes():
            raise PanelError(say("error.node", known=", ".join(self.nodes()), found=node[:80]))
        listed = await self._ask(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        names = sorted(listed.result.names)
        described = await self._ask(
            DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=names)
        )
        got = await self._ask(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
        return tuple(parameter_view(*pair) for pair in zip(described.descriptors, got.values, strict=False))

    async def _ask(self, kind: ServiceType[Request, Response], name: str, request: Request) -> Response:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        client: Client[Request, Response] = self._clients[name]
        if not await wait_until(client.service_is_ready, SERVER_WAIT_S):
            raise PanelError(say("error.no_node", name=name, wait=SERVER_WAIT_S))
        future = client.call_async(request)
        if not await wait_for_answer(future, ANSWER_S):
            client.remove_pending_request(future)
            raise PanelError(say("error.no_answer", name=name, wait=ANSWER_S))
        return future.result()
