# SPDX-License-Identifier: Apache-2.0
"""Nodes: their names, what they own, what they ask the graph, their parameters."""

from __future__ import annotations

import contextlib
import functools
import math
import warnings
import weakref
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import NodeNameNonExistentError, RCLInvalidROSArgsError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ROSClock
from rclpy.constants import S_TO_NS
from rclpy.context import parse_arguments
from rclpy.destroyable import Destroyable
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    NameValidationException,
    NotInitializedException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy.executors import Executor
from rclpy.guard_condition import GuardCondition
from rclpy.logging import get_logger
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter
from rclpy.parameter_checks import REL_TOL, is_listed, make_descriptor, make_result, problem
from rclpy.parameter_service import ParameterService
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_rosout_default,
    qos_profile_services_default,
)
from rclpy.qos_overriding_options import QoSOverridingOptions, _declare_qos_parameters
from rclpy.rosout import Rosout
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.time_source import TimeSource
from rclpy.timer import Rate, Timer
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_description_service import TypeDescriptionService
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type
from rclpy.utilities import get_default_context
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_parameter_name import validate_parameter_name
from rclpy.validate_topic_name import validate_topic_name

from embedded_ros import names
from embedded_ros.errors import needs_ros2
from embedded_ros.graph import names_and_types
from embedded_ros.session import Link
from embedded_ros.throttle import Throttle
from embedded_ros.wire import Entity, EntityKind, encode_token

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context
    from rclpy.endpoint import Endpoint
    from rclpy.impl.rcutils_logger import RcutilsLogger
    from rclpy.waitable import Waitable


class Node:
    """A node: owns publishers, subscriptions, services, clients, timers and parameters.

    A user's class shares this namespace: beside the names that the real rclpy has, too, all private ones begin with
    ``_rcl_``, so that no attribute of a user's node can replace one of them.
    """

    PARAM_REL_TOL = REL_TOL

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

        self._parameter_event_publisher: Publisher = self.create_publisher(
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

    # -- identity -------------------------------------------------------------------------------------------------

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

    def _rcl_ready(self, entity: Endpoint | Timer) -> None:
        """Make the executor run an entity that has become ready; called on Zenoh's threads."""
        reference = self._rcl_executor_reference
        if reference is not None and (executor := reference()) is not None:
            if entity._is_entity:
                executor._hint(entity, self)
            else:
                executor.wake()

    def _rcl_wake(self) -> None:
        reference = self._rcl_executor_reference
        if reference is not None and (executor := reference()) is not None:
            executor.wake()

    def _wake_executor(self) -> None:
        self._rcl_wake()

    # -- names ----------------------------------------------------------------------------------------------------

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

    # -- entities -------------------------------------------------------------------------------------------------

    def _rcl_init_entities(self) -> None:
        self._publishers: list[Publisher] = []
        self._subscriptions: list[Subscription] = []
        self._clients: list[Client[Any, Any]] = []
        self._services: list[Service] = []
        self._timers: list[Timer] = []
        self._guards: list[GuardCondition] = []
        self._rcl_waitables: list[Waitable] = []
        self._rcl_rates: list[Rate] = []
        self._rcl_entity_list: list[Any] | None = None

    def _rcl_entities(self) -> list[Any]:
        """Return what an executor has to look at, timers first."""
        found = self._rcl_entity_list
        if found is None:
            found = self._rcl_entity_list = [
                *self._timers,
                *self._subscriptions,
                *self._guards,
                *self._clients,
                *self._services,
                *self._rcl_waitables,
            ]
        return found

    def _rcl_changed(self) -> None:
        """Make the executor see that an entity came or went."""
        self._rcl_entity_list = None
        self._rcl_wake()

    # -- entities: lists ------------------------------------------------------------------------------------------

    @property
    def publishers(self) -> Iterator[Publisher]:
        """The publishers."""
        yield from self._publishers

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions."""
        yield from self._subscriptions

    @property
    def clients(self) -> Iterator[Client[Any, Any]]:
        """The clients."""
        yield from self._clients

    @property
    def services(self) -> Iterator[Service]:
        """The services."""
        yield from self._services

    @property
    def timers(self) -> Iterator[Timer]:
        """The timers."""
        yield from self._timers

    @property
    def guards(self) -> Iterator[GuardCondition]:
        """The guard conditions."""
        yield from self._guards

    @property
    def waitables(self) -> Iterator[Waitable]:
        """The waitables."""
        yield from self._rcl_waitables

    @staticmethod
    def _rcl_profile(qos: QoSProfile | int) -> QoSProfile:
        if isinstance(qos, QoSProfile):
            return qos
        if isinstance(qos, bool) or not isinstance(qos, int):
            raise TypeError(f"Expected QoSProfile or int, but received {type(qos)!r}")
        if qos < 0:
            raise ValueError("history depth must be greater than or equal to zero")
        return QoSProfile(depth=qos)

    def _rcl_group(self, group: CallbackGroup | None) -> CallbackGroup:
        return group if group is not None else self._default_callback_group

    # -- entities: making -----------------------------------------------------------------------------------------

    def create_publisher(
        self,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: PublisherEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        publisher_class: type[Publisher] = Publisher,
    ) -> Any:
        """Make a publisher.

        Raises:
            ValueError: the depth is negative.
            InvalidTopicNameException: the name breaks a rule.
        """
        profile = self._rcl_profile(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._rcl_remapped(topic, "topic")
        if qos_overriding_options is not None:
            profile = profile._copy()
            _declare_qos_parameters(Publisher, self, full, profile, qos_overriding_options)
        group = self._rcl_group(callback_group)
        made = publisher_class(
            self, msg_type, topic, profile, event_callbacks or PublisherEventCallbacks(), group, name=full
        )
        self._publishers.append(made)
        self._rcl_adopt(made.event_handlers, group)
        return made

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        raw: bool = False,
        content_filter_options: object = None,
    ) -> Subscription:
        """Make a subscription; ``raw`` gives the callback the CDR bytes.

        Raises:
            NotImplementedError: content filters need ROS 2.
        """
        if content_filter_options is not None:
            raise needs_ros2("a content filter")
        profile = self._rcl_profile(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._rcl_remapped(topic, "topic")
        if qos_overriding_options is not None:
            profile = profile._copy()
            _declare_qos_parameters(Subscription, self, full, profile, qos_overriding_options)
        group = self._rcl_group(callback_group)
        made = Subscription(
            self, msg_type, topic, callback, group, profile, raw=raw,
            event_callbacks=event_callbacks or SubscriptionEventCallbacks(), name=full,
        )  # fmt: skip
        group.add_entity(made)
        made._is_entity = True
        self._subscriptions.append(made)
        self._rcl_adopt(made.event_handlers, group)
        self._rcl_changed()
        return made

    def _rcl_adopt(self, handlers: Sequence[Waitable], group: CallbackGroup) -> None:
        for handler in handlers:
            group.add_entity(handler)
            self._rcl_waitables.append(handler)
        self._rcl_changed()

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client[Any, Any]:
        """Make a client of a service."""
        check_is_valid_srv_type(srv_type)
        group = self._rcl_group(callback_group)
        made: Client[Any, Any] = Client(self, srv_type, self._rcl_remapped(srv_name, "service"), qos_profile, group)
        group.add_entity(made)
        made._is_entity = True
        self._clients.append(made)
        self._rcl_changed()
        return made

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Make a server of a service."""
        check_is_valid_srv_type(srv_type)
        group = self._rcl_group(callback_group)
        made = Service(self, srv_type, self._rcl_remapped(srv_name, "service"), callback, group, qos_profile)
        group.add_entity(made)
        made._is_entity = True
        self._services.append(made)
        self._rcl_changed()
        return made

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Make a timer; its clock is the node's unless one is given."""
        period = float(timer_period_sec) * S_TO_NS
        if not math.isfinite(period):
            raise ValueError(f"expected a finite period, found {timer_period_sec}")
        group = self._rcl_group(callback_group)
        made = Timer(callback, group, int(period), clock or self._clock, context=self._context, autostart=autostart)
        # Weakly: a node that is dropped takes its timers along.
        made._wake = functools.partial(_wake_node, weakref.ref(self))
        made._due = functools.partial(_run_timer, weakref.ref(self), weakref.ref(made))
        group.add_entity(made)
        self._timers.append(made)
        self._rcl_changed()
        return made

    def create_guard_condition(
        self, callback: Callable[[], Any], callback_group: CallbackGroup | None = None
    ) -> GuardCondition:
        """Make a guard condition."""
        group = self._rcl_group(callback_group)
        made = GuardCondition(callback, group, context=self._context)
        made._wake = self._rcl_wake
        group.add_entity(made)
        self._guards.append(made)
        self._rcl_changed()
        return made

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """Make a rate."""
        if frequency <= 0:
            raise ValueError("frequency must be > 0")
        made = Rate(
            self.create_timer(1.0 / frequency, None, MutuallyExclusiveCallbackGroup(), clock), context=self._context
        )
        self._rcl_rates.append(made)
        return made

    def add_waitable(self, waitable: Waitable) -> None:
        """Take a waitable on."""
        self._rcl_waitables.append(waitable)
        self._rcl_changed()

    def remove_waitable(self, waitable: Waitable) -> None:
        """Let a waitable go."""
        with contextlib.suppress(ValueError):
            self._rcl_waitables.remove(waitable)
        self._rcl_changed()

    # -- destroying -----------------------------------------------------------------------------------------------

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

    def _rcl_remove(self, entities: list[Any], entity: Any) -> bool:
        if entity not in entities:
            return False
        entities.remove(entity)
        for handler in getattr(entity, "event_handlers", ()):
            self.remove_waitable(handler)
        entity.destroy()
        self._rcl_changed()
        return True

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Withdraw a publisher; return whether it was this node's."""
        return self._rcl_remove(self._publishers, publisher)

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Withdraw a subscription; return whether it was this node's."""
        return self._rcl_remove(self._subscriptions, subscription)

    def destroy_client(self, client: Client[Any, Any]) -> bool:
        """Withdraw a client; return whether it was this node's."""
        return self._rcl_remove(self._clients, client)

    def destroy_service(self, service: Service) -> bool:
        """Withdraw a service; return whether it was this node's."""
        return self._rcl_remove(self._services, service)

    def destroy_timer(self, timer: Timer) -> bool:
        """End a timer; return whether it was this node's."""
        return self._rcl_remove(self._timers, timer)

    def destroy_guard_condition(self, guard: GuardCondition) -> bool:
        """End a guard condition; return whether it was this node's."""
        return self._rcl_remove(self._guards, guard)

    def destroy_rate(self, rate: Rate) -> bool:
        """End a rate; return whether it was this node's."""
        if rate not in self._rcl_rates:
            return False
        self._rcl_rates.remove(rate)
        self.destroy_timer(rate._timer)
        rate.destroy()
        return True

    def _rcl_destroy_entities(self) -> None:
        for rate in list(self._rcl_rates):
            self.destroy_rate(rate)
        for entities in (
            self._publishers,
            self._subscriptions,
            self._clients,
            self._services,
            self._timers,
            self._guards,
        ):
            for entity in list(entities):
                self._rcl_remove(entities, entity)
        for waitable in list(self._rcl_waitables):
            if hasattr(waitable, "destroy"):
                waitable.destroy()
        self._rcl_waitables.clear()
        self._rcl_changed()

    # -- graph ----------------------------------------------------------------------------------------------------

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

    # -- parameters -----------------------------------------------------------------------------------------------

    def _rcl_init_parameters(self, overrides: list[Parameter] | None, allow_undeclared: bool) -> None:
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._pre_set_parameters_callbacks: list[Callable[[list[Parameter]], list[Parameter]]] = []
        self._on_set_parameters_callbacks: list[Callable[[list[Parameter]], Any]] = []
        self._post_set_parameters_callbacks: list[Callable[[list[Parameter]], None]] = []
        self._allow_undeclared_parameters = allow_undeclared
        self._parameter_overrides: dict[str, Parameter] = {}
        for given in reversed(self._rcl_arguments):
            for name, (value, source) in given.parameters_of(self.get_fully_qualified_name()).items():
                try:
                    self._parameter_overrides[name] = Parameter(name, value=value)
                except TypeError as error:
                    raise RCLInvalidROSArgsError(f"{source}: {name}: {error}") from error
        for parameter in overrides or []:
            self._parameter_overrides[parameter.name] = parameter

    def _rcl_declare_overrides(self) -> None:
        from rcl_interfaces.msg import ParameterDescriptor  # noqa: PLC0415  classes are made on first use

        self.declare_parameters(
            "",
            [
                (name, parameter.value, ParameterDescriptor(dynamic_typing=True))
                for name, parameter in self._parameter_overrides.items()
                if name not in self._parameters
            ],
            ignore_override=True,
        )

    # -- parameters: declaring ------------------------------------------------------------------------------------

    def declare_parameter(
        self,
        name: str,
        value: Any = None,
        descriptor: Any = None,
        ignore_override: bool = False,
    ) -> Parameter:
        """Declare a parameter; overrides from the command line and files replace the value.

        Raises:
            ParameterAlreadyDeclaredException, InvalidParameterException, InvalidParameterTypeException,
            InvalidParameterValueException: it cannot be declared like this.
        """
        given = (name,) if value is None and descriptor is None else (name, value, descriptor or make_descriptor())
        return self.declare_parameters("", [given], ignore_override)[0]

    def declare_parameters(
        self,
        namespace: str,
        parameters: Sequence[tuple[Any, ...]],
        ignore_override: bool = False,
    ) -> list[Parameter]:
        """Declare parameters given as (name), (name, value or type) or (name, value or type, descriptor)."""
        found: list[Parameter] = []
        descriptors: dict[str, Any] = {}
        for index, given in enumerate(parameters):
            name, value, descriptor = self._rcl_declaration(namespace, index, given)
            if not ignore_override and name in self._parameter_overrides:
                value = self._parameter_overrides[name].value
            found.append(Parameter(name, value=value))
            descriptors[name] = descriptor
        already = [parameter.name for parameter in found if parameter.name in self._parameters]
        if already:
            raise ParameterAlreadyDeclaredException(already)
        for parameter in found:
            self._rcl_declare(parameter, descriptors)
        return [self._parameters[parameter.name] for parameter in found]

    @staticmethod
    def _rcl_declaration(namespace: str, index: int, given: tuple[Any, ...]) -> tuple[str, Any, Any]:
        if not 1 <= len(given) <= 3:
            raise TypeError(f"parameter {index}: expected (name[, value[, descriptor]]), found {given!r}")
        name = given[0]
        if not isinstance(name, str):
            raise TypeError(f"First element {name} at index {index} in parameters list is not a str.")
        name = f"{namespace}.{name}" if namespace else name
        validate_parameter_name(name)
        second = given[1] if len(given) > 1 else None
        descriptor = given[2] if len(given) > 2 else make_descriptor()
        if not isinstance(descriptor, type(make_descriptor())):
            raise TypeError(
                f"Third element {descriptor} at index {index} in parameters list is not a ParameterDescriptor."
            )
        if len(given) == 1:
            warnings.warn(
                f"when declaring parameter named '{name}', declaring a parameter only by its name is deprecated. "
                "Pass a default value, a parameter type, or a descriptor with dynamic_typing=True",
                stacklevel=4,
            )
            descriptor.dynamic_typing = True
        if isinstance(second, Parameter.Type):
            if second is Parameter.Type.NOT_SET:
                raise ValueError(f"Cannot declare parameter {{{name}}} as statically typed of type NOT_SET")
            if descriptor.dynamic_typing:
                raise ValueError(f"parameter {{{name}}}: dynamic_typing=True is not allowed when the type is given")
            descriptor.type = second.value
            return name, None, descriptor
        if not descriptor.dynamic_typing:
            definition = getattr(type(second), "DEFINITION", None)
            if (
                second is not None
                and definition is not None
                and definition.text.name == "rcl_interfaces/msg/ParameterValue"
            ):
                descriptor.type = second.type
            else:
                descriptor.type = Parameter.Type.from_parameter_value(second).value
            if descriptor.type == 0:
                raise ValueError(
                    "Cannot declare a statically typed parameter with default value of type PARAMETER_NOT_SET"
                )
        return name, second, descriptor

    def _rcl_declare(self, parameter: Parameter, descriptors: dict[str, Any]) -> None:
        result = self._set_parameters_atomically_common([parameter], descriptors, allow_not_set_type=True)
        if not result.successful:
            if result.reason.startswith("Wrong parameter type"):
                expected = Parameter.Type(descriptors[parameter.name].type)
                raise InvalidParameterTypeException(parameter, expected.name)
            raise InvalidParameterValueException(parameter.name, parameter.value, result.reason)

    def undeclare_parameter(self, name: str) -> None:
        """Remove a parameter."""
        if self.has_parameter(name):
            if self._descriptors[name].read_only:
                raise ParameterImmutableException(name)
            del self._parameters[name]
            del self._descriptors[name]
        else:
            raise ParameterNotDeclaredException(name)

    def has_parameter(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return name in self._parameters

    # -- parameters: reading --------------------------------------------------------------------------------------

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter.

        Raises:
            ParameterNotDeclaredException: it is not declared (and undeclared ones are not allowed).
            ParameterUninitializedException: it has a type but no value.
        """
        if self.has_parameter(name):
            parameter = self._parameters[name]
            if parameter.type_ is not Parameter.Type.NOT_SET or self._descriptors[name].dynamic_typing:
                return parameter
            raise ParameterUninitializedException(name)
        if self._allow_undeclared_parameters:
            return Parameter(name, Parameter.Type.NOT_SET, None)
        raise ParameterNotDeclaredException(name)

    def get_parameters(self, names: list[str]) -> list[Parameter]:
        """Return several parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """Return a parameter, or the alternative when it is not declared or has no value."""
        if alternative_value is None:
            alternative_value = Parameter(name, Parameter.Type.NOT_SET)
        parameter = self._parameters.get(name, alternative_value)
        return alternative_value if parameter.type_ is Parameter.Type.NOT_SET else parameter

    def get_parameter_types(self, names: list[str]) -> list[Parameter.Type]:
        """Return the types of several parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter_type(name) for name in names]

    def get_parameter_type(self, name: str) -> Parameter.Type:
        """Return the type of a parameter."""
        if self.has_parameter(name):
            return self._parameters[name].type_
        if self._allow_undeclared_parameters:
            return Parameter.Type.NOT_SET
        raise ParameterNotDeclaredException(name)

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters under a prefix, by what follows it."""
        head = prefix + PARAMETER_SEPARATOR_STRING if prefix else ""
        return {name[len(head) :]: value for name, value in self._parameters.items() if name.startswith(head)}

    def list_parameters(self, prefixes: list[str], depth: int) -> Any:
        """Return names (and prefixes) of parameters down to a depth; 0 is any depth."""
        from rcl_interfaces.msg import ListParametersResult  # noqa: PLC0415  classes are made on first use

        if not isinstance(prefixes, list):
            raise TypeError("The prefixes argument must be a list")
        if not all(isinstance(prefix, str) for prefix in prefixes):
            raise TypeError("All prefixes must be instances of type str")
        if not isinstance(depth, int):
            raise TypeError("The depth must be instance of type int")
        if depth < 0:
            raise ValueError("The depth must be greater than or equal to zero")
        result = ListParametersResult()
        for name in self._parameters:
            if is_listed(name, prefixes, depth):
                result.names.append(name)
                prefix = name.rpartition(PARAMETER_SEPARATOR_STRING)[0]
                if prefix and prefix not in result.prefixes:
                    result.prefixes.append(prefix)
        return result

    # -- parameters: setting --------------------------------------------------------------------------------------

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Any]:
        """Set parameters one by one; return a result for each."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """Set all or none."""
        wrong = [item for item in parameter_list if not isinstance(item, Parameter)]
        if wrong:
            raise TypeError(f"expected rclpy.parameter.Parameter, found {wrong[0]!r}")
        for callback in self._pre_set_parameters_callbacks:
            parameter_list = callback(parameter_list)
        if self._pre_set_parameters_callbacks and not parameter_list:
            return make_result(
                "parameter list cannot be empty, this might be due to pre_set_parameters_callback modifying the "
                "original parameters list."
            )
        if not self._allow_undeclared_parameters:
            unknown = [parameter.name for parameter in parameter_list if not self.has_parameter(parameter.name)]
            if unknown:
                raise ParameterNotDeclaredException(unknown)
        return self._set_parameters_atomically_common(parameter_list)

    def _set_parameters_atomically_common(
        self,
        parameter_list: list[Parameter],
        descriptors: dict[str, Any] | None = None,
        *,
        allow_not_set_type: bool = False,
    ) -> Any:
        for parameter in parameter_list:
            known = descriptors if descriptors is not None else self._descriptors
            if parameter.name in known:
                reason = problem(
                    parameter,
                    known[parameter.name],
                    declared=self.has_parameter(parameter.name),
                    check_read_only=descriptors is None,
                )
                if reason:
                    return make_result(reason)
        for callback in self._on_set_parameters_callbacks:
            result = callback(parameter_list)
            if not hasattr(result, "successful"):
                warnings.warn("Callback returned an invalid type, it should return SetParameterResult.", stacklevel=3)
                return make_result("Callback returned an invalid type")
            if not result.successful:
                return result
        self._rcl_store(parameter_list, descriptors, allow_not_set_type=allow_not_set_type)
        for post in self._post_set_parameters_callbacks:
            post(parameter_list)
        return make_result()

    def _rcl_store(
        self, parameter_list: list[Parameter], descriptors: dict[str, Any] | None, *, allow_not_set_type: bool
    ) -> None:
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        event = ParameterEvent(node=self.get_fully_qualified_name())
        for parameter in parameter_list:
            name = parameter.name
            if parameter.type_ is Parameter.Type.NOT_SET and not allow_not_set_type:
                event.deleted_parameters.append(parameter.to_parameter_msg())
                self._parameters.pop(name, None)
                self._descriptors.pop(name, None)
                continue
            if descriptors is not None:
                self._descriptors[name] = descriptors[name]
            elif name not in self._descriptors:
                self._descriptors[name] = make_descriptor(dynamic_typing=True)
            new = self.get_parameter_or(name).type_ is Parameter.Type.NOT_SET
            (event.new_parameters if new else event.changed_parameters).append(parameter.to_parameter_msg())
            self._parameters[name] = parameter
        event.stamp = self._clock.now().to_msg()
        self._parameter_event_publisher.publish(event)

    def describe_parameter(self, name: str) -> Any:
        """Return the descriptor of a parameter."""
        if name in self._descriptors:
            return self._descriptors[name]
        if self._allow_undeclared_parameters:
            return make_descriptor()
        raise ParameterNotDeclaredException(name)

    def describe_parameters(self, names: list[str]) -> list[Any]:
        """Return the descriptors of several parameters."""
        return [self.describe_parameter(name) for name in names]

    def set_descriptor(self, name: str, descriptor: Any, alternative_value: Any = None) -> Any:
        """Give a parameter a new descriptor; the alternative replaces a value that does not suit it."""
        from rcl_interfaces.msg import Parameter as Message  # noqa: PLC0415  classes are made on first use

        if not self.has_parameter(name):
            if not self._allow_undeclared_parameters:
                raise ParameterNotDeclaredException(name)
            return self.get_parameter(name).get_parameter_value()
        if self.describe_parameter(name).read_only:
            raise ParameterImmutableException(name)
        current = self.get_parameter(name)
        if problem(current, descriptor, declared=True, check_read_only=False):
            if alternative_value is not None:
                current = Parameter.from_parameter_msg(Message(name=name, value=alternative_value))
            reason = problem(current, descriptor, declared=True, check_read_only=False)
            if reason:
                raise InvalidParameterValueException(name, current.value, reason)
        self._parameters[name] = current
        self._descriptors[name] = descriptor
        return current.get_parameter_value()

    # -- parameters: callbacks ------------------------------------------------------------------------------------

    def add_pre_set_parameters_callback(self, callback: Callable[[list[Parameter]], list[Parameter]]) -> None:
        """Call before anything is checked; the callback may change the list."""
        self._pre_set_parameters_callbacks.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Call to accept or refuse; the last one added is asked first."""
        self._on_set_parameters_callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: Callable[[list[Parameter]], None]) -> None:
        """Call when parameters have been set."""
        self._post_set_parameters_callbacks.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: Callable[[list[Parameter]], list[Parameter]]) -> None:
        """Stop calling."""
        self._pre_set_parameters_callbacks.remove(callback)

    def remove_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Stop calling."""
        self._on_set_parameters_callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: Callable[[list[Parameter]], None]) -> None:
        """Stop calling."""
        self._post_set_parameters_callbacks.remove(callback)


def _wake_node(reference: weakref.ref[Node]) -> None:
    node = reference()
    if node is not None:
        node._rcl_wake()


def _run_timer(node_reference: weakref.ref[Node], reference: weakref.ref[Timer]) -> None:
    node, timer = node_reference(), reference()
    if node is not None and timer is not None:
        node._rcl_ready(timer)


def _infos(entities: Iterable[Entity]) -> list[TopicEndpointInfo]:
    return [TopicEndpointInfo._from_entity(entity) for entity in entities]
