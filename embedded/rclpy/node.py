# SPDX-License-Identifier: Apache-2.0
"""Nodes."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ROSClock
from rclpy.context import parse_arguments
from rclpy.destroyable import Destroyable
from rclpy.exceptions import NotInitializedException
from rclpy.executors import Executor
from rclpy.logging import get_logger
from rclpy.node_entities import NodeEntities
from rclpy.node_graph import NodeGraph
from rclpy.node_parameters import NodeParameters
from rclpy.parameter_service import ParameterService
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_rosout_default,
)
from rclpy.rosout import Rosout
from rclpy.time_source import TimeSource
from rclpy.type_description_service import TypeDescriptionService
from rclpy.utilities import get_default_context
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_topic_name import validate_topic_name

from embedded_ros import names
from embedded_ros.session import Link
from embedded_ros.throttle import Throttle
from embedded_ros.wire import Entity, EntityKind, encode_token

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context
    from rclpy.endpoint import Endpoint
    from rclpy.impl.rcutils_logger import RcutilsLogger
    from rclpy.parameter import Parameter


class Node(NodeParameters, NodeGraph, NodeEntities):
    """A node: owns publishers, subscriptions, services, clients, timers and parameters.

    A user's class shares this namespace: beside the names that the real rclpy has, too, all private ones begin with
    ``_rcl_``, so that no attribute of a user's node can replace one of them.
    """

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        rosout_qos_profile: QoSProfile | int = qos_profile_rosout_default,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
    ) -> None:
        self._context = context or get_default_context()
        self._rcl_executor_reference: weakref.ref[Executor] | None = None
        self._rcl_init_entities()
        self._rcl_handle = Destroyable()
        self._rcl_throttle = Throttle()
        self._default_callback_group = MutuallyExclusiveCallbackGroup()
        if not self._context.ok():
            raise NotInitializedException("cannot create node")
        validate_node_name(node_name)
        namespace = namespace or ""
        namespace = namespace if namespace.startswith("/") else "/" + namespace
        validate_namespace(namespace)
        self._rcl_set_arguments(cli_args, use_global=use_global_arguments)
        own_name = next(
            (a.node_name(node_name) for a in self._rcl_arguments if a.node_name(node_name) != node_name), node_name
        )
        self._rcl_namespace = next(
            (
                a.namespace(node_name, namespace)
                for a in self._rcl_arguments
                if a.namespace(node_name, namespace) != namespace
            ),
            namespace,
        )
        self._rcl_name = own_name
        self._rcl_resolved_names: dict[tuple[str, str], str] = {}
        self._rcl_logger_name = (self._rcl_namespace.replace("/", ".").strip(".") + "." + own_name).lstrip(".")
        self._logger = get_logger(self._rcl_logger_name)
        self._rcl_link = Link(self._context._session())
        self._rcl_node_id = next(self._context._ids)
        entity = Entity(
            self._context._domain, self._rcl_link.zid, self._rcl_node_id, self._rcl_node_id, EntityKind.NODE,
            self._rcl_namespace, own_name, self._context._arguments.enclave,
        )  # fmt: skip
        self._rcl_token_key = encode_token(entity)
        self._rcl_token = self._rcl_link.token(self._rcl_token_key)
        self._context._graph.add(self._rcl_token_key)
        self._clock = ROSClock()
        self._rcl_rosout: Rosout | None = None
        if enable_rosout and self._context._arguments.rosout:
            topic, profile = self._rcl_remapped("/rosout", "topic"), self._rcl_profile(rosout_qos_profile)
            self._rcl_rosout = Rosout(self, topic, profile)
        self._rcl_init_parameters(parameter_overrides, allow_undeclared_parameters)
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        self._parameter_event_publisher: Publisher | None = self.create_publisher(
            ParameterEvent, "/parameter_events", qos_profile_parameter_events
        )
        if automatically_declare_parameters_from_overrides:
            self._rcl_declare_overrides()
        self._time_source = TimeSource(node=self)
        self._time_source.attach_clock(self._clock)
        if start_parameter_services:
            self._parameter_service = ParameterService(self)
        self._type_description_service = TypeDescriptionService(self)
        if enable_logger_service:
            from rclpy.logging_service import LoggingService  # noqa: PLC0415  off by default

            self._logger_service = LoggingService(self)

    def _rcl_set_arguments(self, cli_args: list[str] | None, *, use_global: bool) -> None:
        self._rcl_arguments = [parse_arguments(list(cli_args))] if cli_args else []
        if use_global:
            self._rcl_arguments.append(self._context._arguments)

    # -- identity ---------------------------------------------------------------------------------------------

    def get_name(self) -> str:
        """Return the name."""
        return self._rcl_name

    def get_namespace(self) -> str:
        """Return the namespace, ``/`` for the root."""
        return self._rcl_namespace

    def get_fully_qualified_name(self) -> str:
        """Return ``/namespace/name``."""
        return f"{self._rcl_namespace.rstrip('/')}/{self._rcl_name}"

    def get_logger(self) -> RcutilsLogger:
        """Return the logger."""
        return self._logger

    def get_clock(self) -> Clock:
        """Return the clock: ROS time."""
        return self._clock

    @property
    def handle(self) -> Destroyable:
        """Raises InvalidHandle in a ``with`` once the node is destroyed; there is no C handle here."""
        return self._rcl_handle

    @property
    def context(self) -> Context:
        """The context."""
        return self._context

    @property
    def default_callback_group(self) -> CallbackGroup:
        """The group of entities that are given none."""
        return self._default_callback_group

    @property
    def executor(self) -> Executor | None:
        """The executor that runs this node, if any."""
        return self._rcl_executor_reference() if self._rcl_executor_reference is not None else None

    @executor.setter
    def executor(self, new_executor: Executor | None) -> None:
        current = self.executor
        if current is new_executor:
            return
        if current is not None:
            current.remove_node(self)
        self._rcl_executor_reference = None if new_executor is None else weakref.ref(new_executor)
        if new_executor is not None:
            new_executor.add_node(self)

    def _rcl_ready(self, endpoint: Endpoint) -> None:
        """Have the executor run an endpoint that has become ready; called on Zenoh's threads."""
        reference = self._rcl_executor_reference
        if reference is not None and (executor := reference()) is not None:
            if endpoint._is_entity:
                executor._hint(endpoint, self)
            else:
                executor.wake()

    def _rcl_wake(self) -> None:
        reference = self._rcl_executor_reference
        if reference is not None and (executor := reference()) is not None:
            executor.wake()

    def _wake_executor(self) -> None:
        self._rcl_wake()

    # -- names ------------------------------------------------------------------------------------------------

    def _rcl_full_name(self, name: str, kind: str) -> str:
        validate_topic_name(name, is_service=kind == "service")
        try:
            full = names.expand(name, self._rcl_name, self._rcl_namespace)
        except KeyError as error:
            raise ValueError(f"'{name}': unknown substitution {error}; known are node, ns, namespace") from None
        validate_full_topic_name(full, is_service=kind == "service")
        return full

    def _rcl_remapped(self, name: str, kind: str) -> str:
        known = self._rcl_resolved_names.get((name, kind))
        if known is None:
            known = self._rcl_resolved_names[name, kind] = self._rcl_remap(self._rcl_full_name(name, kind), kind)
        return known

    def _rcl_remap(self, full: str, kind: str) -> str:
        for given in self._rcl_arguments:
            mapped = names.remap_name(full, kind, self._rcl_name, self._rcl_namespace, given.remaps)
            if mapped != full:
                return mapped
        return full

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a topic, remapped unless only expanded."""
        return self._rcl_full_name(topic, "topic") if only_expand else self._rcl_remapped(topic, "topic")

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a service, remapped unless only expanded."""
        return self._rcl_full_name(service, "service") if only_expand else self._rcl_remapped(service, "service")

    def destroy_node(self) -> None:
        """Withdraw the node with all it owns."""
        if self._rcl_handle._destroyed:
            return
        self._rcl_handle.destroy()
        if (executor := self.executor) is not None:
            executor.remove_node(self)
        if self._rcl_rosout is not None:
            self._rcl_rosout.destroy()
        self._rcl_destroy_entities()
        self._context._graph.remove(self._rcl_token_key)
        self._rcl_link.withdraw(self._rcl_token)
