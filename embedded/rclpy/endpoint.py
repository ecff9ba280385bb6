# SPDX-License-Identifier: Apache-2.0
"""What publishers, subscriptions, services and clients share: key, gid, token, matching."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import zenoh
from rclpy.destroyable import Destroyable

from embedded_ros import wire
from embedded_ros.graph import incompatible_policy
from embedded_ros.session import Link
from embedded_ros.wire import Entity, EntityKind

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

_OPPOSITE = {
    EntityKind.PUBLISHER: EntityKind.SUBSCRIPTION,
    EntityKind.SUBSCRIPTION: EntityKind.PUBLISHER,
}


def full_type_name(kind: Any) -> str:
    """Return ``pkg/kind/Name`` of an interface class."""
    name: str = kind.DEFINITION.text.name
    return name


class Endpoint(Destroyable):
    """Base of the endpoints of a node."""

    _is_entity = False  # whether the executor runs it itself; those of actions are run by the action

    def __init__(self, node: Node, kind: EntityKind, name: str, interface: Any, qos: QoSProfile) -> None:
        self._node = node
        self._name = name
        self.qos_profile = qos._copy()
        self._destroyed = False
        self._link = Link(node.context._session())
        context = node.context
        self._wire_qos = qos._to_wire()
        type_name = wire.dds_type_name(full_type_name(interface))
        self._entity = Entity(
            context._domain,
            self._link.zid,
            node._rcl_node_id,
            next(context._ids),
            kind,
            node.get_namespace(),
            node.get_name(),
            context._arguments.enclave,
            name,
            type_name,
            interface.DEFINITION.type_hash,
            self._wire_qos,
        )
        self._token_key = wire.encode_token(self._entity)
        self._gid = wire.gid_of(self._token_key)
        self._key = wire.data_key(context._domain, name, type_name, self._entity.hash)
        self._token: zenoh.LivelinessToken | None = None
        #: by kind, the graph's version and who matched then: nodes ask often, and it hardly ever is new
        self._matches: dict[EntityKind, tuple[int, list[Entity]]] = {}

    @property
    def logger_name(self) -> str:
        """The name of the node's logger."""
        return str(self._node.get_logger().name)

    def _announce(self) -> None:
        """Declare the liveliness token, after everything it promises is there."""
        self._token = self._link.token(self._token_key)
        self._node.context._graph.add(self._token_key)

    def _matched(self, kind: EntityKind) -> list[Entity]:
        """Return the endpoints of a kind on the same name and type whose QoS DDS would match with ours."""
        graph = self._node.context._graph
        version = graph.version
        known = self._matches.get(kind)
        if known is not None and known[0] == version:
            return known[1]
        found = []
        for other in graph.endpoints(self._name, kind):
            offered, requested = (
                (self._wire_qos, other.qos) if kind is EntityKind.SUBSCRIPTION else (other.qos, self._wire_qos)
            )
            if other.type == self._entity.type and incompatible_policy(offered, requested) is None:
                found.append(other)
        self._matches[kind] = version, found
        return found

    def _undeclare(self) -> None:
        raise NotImplementedError

    def destroy(self) -> None:
        """Withdraw from the network."""
        if self._destroyed:
            return
        self._destroyed = True
        for handler in getattr(self, "event_handlers", []):
            handler.destroy()
        self._node.context._graph.remove(self._token_key)
        with contextlib.suppress(zenoh.ZError):
            if self._token is not None:
                self._link.withdraw(self._token)
            self._undeclare()

    def __exit__(self, *_: object) -> None:
        """Leave it as it is: ``with publisher.handle:`` only holds on to it."""
