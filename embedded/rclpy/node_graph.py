# SPDX-License-Identifier: Apache-2.0
"""What a node can ask about the graph: who publishes, subscribes and serves what."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import NodeNameNonExistentError
from rclpy.exceptions import NameValidationException
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_node_name import validate_node_name

from embedded_ros.graph import names_and_types
from embedded_ros.wire import Entity, EntityKind

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rclpy.context import Context


class NodeGraph:
    """Graph queries; mixed into Node."""

    _context: Context

    def _rcl_of_node(self, name: str, namespace: str, kind: EntityKind) -> list[Entity]:
        validate_node_name(name)
        graph = self._context._graph
        node = (namespace or "/", name)
        if not any((entity.namespace, entity.node) == node for entity in graph.snapshot(EntityKind.NODE)):
            raise NodeNameNonExistentError(f"Cannot get information about unknown node: {namespace.rstrip('/')}/{name}")
        return [entity for entity in graph.snapshot(kind) if (entity.namespace, entity.node) == node]

    def get_publisher_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002
    ) -> list[tuple[str, list[str]]]:
        """Return (topic, types) that a node publishes."""
        return names_and_types(self._rcl_of_node(node_name, node_namespace, EntityKind.PUBLISHER))

    def get_subscriber_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002
    ) -> list[tuple[str, list[str]]]:
        """Return (topic, types) that a node subscribes to."""
        return names_and_types(self._rcl_of_node(node_name, node_namespace, EntityKind.SUBSCRIPTION))

    def get_service_names_and_types_by_node(self, node_name: str, node_namespace: str) -> list[tuple[str, list[str]]]:
        """Return (service, types) that a node serves."""
        return names_and_types(self._rcl_of_node(node_name, node_namespace, EntityKind.SERVICE))

    def get_client_names_and_types_by_node(self, node_name: str, node_namespace: str) -> list[tuple[str, list[str]]]:
        """Return (service, types) that a node calls."""
        return names_and_types(self._rcl_of_node(node_name, node_namespace, EntityKind.CLIENT))

    def get_topic_names_and_types(self, no_demangle: bool = False) -> list[tuple[str, list[str]]]:  # noqa: ARG002
        """Return all (topic, types)."""
        return names_and_types(self._context._graph.snapshot(EntityKind.PUBLISHER, EntityKind.SUBSCRIPTION))

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        """Return all (service, types)."""
        return names_and_types(self._context._graph.snapshot(EntityKind.SERVICE))

    def _rcl_nodes(self) -> list[Entity]:
        return self._context._graph.snapshot(EntityKind.NODE)

    def get_node_names(self) -> list[str]:
        """Return the names of all nodes."""
        return [entity.node for entity in self._rcl_nodes()]

    def get_fully_qualified_node_names(self) -> list[str]:
        """Return the full names of all nodes."""
        return [entity.full_node_name for entity in self._rcl_nodes()]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Return (name, namespace) of all nodes."""
        return [(entity.node, entity.namespace) for entity in self._rcl_nodes()]

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        """Return (name, namespace, enclave) of all nodes."""
        return [(entity.node, entity.namespace, entity.enclave) for entity in self._rcl_nodes()]

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a topic."""
        raise NotImplementedError

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a service."""
        raise NotImplementedError

    def _rcl_resolved(self, name: str, *, service: bool) -> str:
        if not isinstance(name, str):
            raise TypeError(f"expected a name, found {name!r}")
        try:
            return self.resolve_service_name(name) if service else self.resolve_topic_name(name)
        except NameValidationException as error:
            raise ValueError(
                f"{'service' if service else 'topic'} name '{name}' is invalid: {error.error_msg}"
            ) from error

    def _rcl_count(self, name: str, kind: EntityKind) -> int:
        full = self._rcl_resolved(name, service=kind in {EntityKind.SERVICE, EntityKind.CLIENT})
        return len(self._context._graph.endpoints(full, kind))

    def count_publishers(self, topic_name: str) -> int:
        """Return how many publishers a topic has."""
        return self._rcl_count(topic_name, EntityKind.PUBLISHER)

    def count_subscribers(self, topic_name: str) -> int:
        """Return how many subscriptions a topic has."""
        return self._rcl_count(topic_name, EntityKind.SUBSCRIPTION)

    def count_services(self, service_name: str) -> int:
        """Return how many servers a service has."""
        return self._rcl_count(service_name, EntityKind.SERVICE)

    def count_clients(self, service_name: str) -> int:
        """Return how many clients a service has."""
        return self._rcl_count(service_name, EntityKind.CLIENT)

    def _rcl_info(self, topic_name: str, kind: EntityKind, no_mangle: bool) -> list[TopicEndpointInfo]:
        full = topic_name if no_mangle else self._rcl_resolved(topic_name, service=False)
        validate_full_topic_name(full)
        return _infos(self._context._graph.endpoints(full, kind))

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[TopicEndpointInfo]:
        """Return node, type, QoS and gid of each publisher of a topic."""
        return self._rcl_info(topic_name, EntityKind.PUBLISHER, no_mangle)

    def get_subscriptions_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[TopicEndpointInfo]:
        """Return node, type, QoS and gid of each subscription of a topic."""
        return self._rcl_info(topic_name, EntityKind.SUBSCRIPTION, no_mangle)

    def wait_for_node(self, fully_qualified_node_name: str, timeout: float) -> bool:
        """Wait until a node is up; return whether it is."""
        requested = "/" + fully_qualified_node_name.lstrip("/")
        graph = self._context._graph
        return graph.wait(lambda: requested in self.get_fully_qualified_node_names(), timeout)

    def duplicate_names(self) -> list[str]:
        """Return full names that more than one node has."""
        counts: Any = Counter(self.get_fully_qualified_node_names())
        return [name for name, count in counts.items() if count > 1]


def _infos(entities: Iterable[Entity]) -> list[TopicEndpointInfo]:
    return [TopicEndpointInfo._from_entity(entity) for entity in entities]
