# SPDX-License-Identifier: Apache-2.0
"""Nodes."""

from __future__ import annotations

import contextlib
import functools
import math
import weakref
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ROSClock
from rclpy.constants import S_TO_NS
from rclpy.context import parse_arguments
from rclpy.destroyable import Destroyable
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import NotInitializedException
from rclpy.executors import Executor
from rclpy.guard_condition import GuardCondition
from rclpy.impl import rcutils_logger
from rclpy.logging import get_logger
from rclpy.node_graph import NodeGraph
from rclpy.node_parameters import NodeParameters
from rclpy.parameter_service import ParameterService
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_rosout_default,
    qos_profile_services_default,
)
from rclpy.qos_overriding_options import QoSOverridingOptions, _declare_qos_parameters
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.time_source import TimeSource
from rclpy.timer import Rate, Timer
from rclpy.type_description_service import TypeDescriptionService
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type
from rclpy.utilities import get_default_context
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_topic_name import validate_topic_name

from embedded_ros import names
from embedded_ros.session import Link
from embedded_ros.wire import Entity, EntityKind, encode_token

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context
    from rclpy.impl.rcutils_logger import CallerId, RcutilsLogger
    from rclpy.parameter import Parameter
    from rclpy.waitable import Waitable


class Node(NodeParameters, NodeGraph, Destroyable):
    """A node: owns publishers, subscriptions, services, clients, timers and parameters."""

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
        self._executor_reference: weakref.ref[Executor] | None = None
        self._publishers: list[Publisher] = []
        self._subscriptions: list[Subscription] = []
        self._clients: list[Client] = []
        self._services: list[Service] = []
        self._timers: list[Timer] = []
        self._guards: list[GuardCondition] = []
        self._waitables: list[Waitable] = []
        self._rates: list[Rate] = []
        self._entity_list: list[Any] | None = None
        self._destroyed = False
        self._default_callback_group = MutuallyExclusiveCallbackGroup()
        if not self._context.ok():
            raise NotInitializedException("cannot create node")
        validate_node_name(node_name)
        namespace = namespace or ""
        namespace = namespace if namespace.startswith("/") else "/" + namespace
        validate_namespace(namespace)
        self._set_arguments(cli_args, use_global=use_global_arguments)
        own_name = next(
            (a.node_name(node_name) for a in self._arguments if a.node_name(node_name) != node_name), node_name
        )
        self._namespace = next(
            (
                a.namespace(node_name, namespace)
                for a in self._arguments
                if a.namespace(node_name, namespace) != namespace
            ),
            namespace,
        )
        self._name = own_name
        self._logger_name = (self._namespace.replace("/", ".").strip(".") + "." + own_name).lstrip(".")
        self._logger = get_logger(self._logger_name)
        self._link = Link(self._context._session())
        self._node_id = next(self._context._ids)
        entity = Entity(self._context._domain, self._link.zid, self._node_id, self._node_id, EntityKind.NODE,
                        self._namespace, own_name, self._context._arguments.enclave)  # fmt: skip
        self._token_key = encode_token(entity)
        self._token = self._link.token(self._token_key)
        self._context._graph.add(self._token_key)
        self._clock = ROSClock()
        self._rosout: Publisher | None = None
        if enable_rosout and self._context._arguments.rosout:
            self._start_rosout(rosout_qos_profile)
        self._init_parameters(parameter_overrides, allow_undeclared_parameters)
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        self._parameter_event_publisher: Publisher | None = self.create_publisher(
            ParameterEvent, "/parameter_events", qos_profile_parameter_events
        )
        if automatically_declare_parameters_from_overrides:
            self._declare_overrides()
        self._time_source = TimeSource(node=self)
        self._time_source.attach_clock(self._clock)
        if start_parameter_services:
            self._parameter_service = ParameterService(self)
        self._type_description_service = TypeDescriptionService(self)
        if enable_logger_service:
            from rclpy.logging_service import LoggingService  # noqa: PLC0415  off by default

            self._logger_service = LoggingService(self)

    def _set_arguments(self, cli_args: list[str] | None, *, use_global: bool) -> None:
        self._arguments = [parse_arguments(list(cli_args))] if cli_args else []
        if use_global:
            self._arguments.append(self._context._arguments)

    # -- identity ---------------------------------------------------------------------------------------------

    def get_name(self) -> str:
        """Return the name."""
        return self._name

    def get_namespace(self) -> str:
        """Return the namespace, ``/`` for the root."""
        return self._namespace

    def get_fully_qualified_name(self) -> str:
        """Return ``/namespace/name``."""
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def get_logger(self) -> RcutilsLogger:
        """Return the logger."""
        return self._logger

    def get_clock(self) -> Clock:
        """Return the clock: ROS time."""
        return self._clock

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
        return self._executor_reference() if self._executor_reference is not None else None

    @executor.setter
    def executor(self, new_executor: Executor | None) -> None:
        current = self.executor
        if current is new_executor:
            return
        if current is not None:
            current.remove_node(self)
        self._executor_reference = None if new_executor is None else weakref.ref(new_executor)
        if new_executor is not None:
            new_executor.add_node(self)

    def _wake(self) -> None:
        reference = self._executor_reference
        if reference is not None and (executor := reference()) is not None:
            executor.wake()

    def _wake_executor(self) -> None:
        self._wake()

    def _entities(self) -> list[Any]:
        """Return what an executor has to look at, timers first."""
        found = self._entity_list
        if found is None:
            found = self._entity_list = [
                *self._timers,
                *self._subscriptions,
                *self._guards,
                *self._clients,
                *self._services,
                *self._waitables,
            ]
        return found

    def _changed(self) -> None:
        """Have the executor see that an entity came or went."""
        self._entity_list = None
        self._wake()

    # -- lists ------------------------------------------------------------------------------------------------

    @property
    def publishers(self) -> Iterator[Publisher]:
        """The publishers."""
        yield from self._publishers

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions."""
        yield from self._subscriptions

    @property
    def clients(self) -> Iterator[Client]:
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
        yield from self._waitables

    # -- names ------------------------------------------------------------------------------------------------

    def _full_name(self, name: str, kind: str) -> str:
        validate_topic_name(name, is_service=kind == "service")
        try:
            full = names.expand(name, self._name, self._namespace)
        except KeyError as error:
            raise ValueError(f"'{name}': unknown substitution {error}; known are node, ns, namespace") from None
        validate_full_topic_name(full, is_service=kind == "service")
        return full

    def _remapped(self, name: str, kind: str) -> str:
        full = self._full_name(name, kind)
        for given in self._arguments:
            mapped = names.remap_name(full, kind, self._name, self._namespace, given.remaps)
            if mapped != full:
                return mapped
        return full

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a topic, remapped unless only expanded."""
        return self._full_name(topic, "topic") if only_expand else self._remapped(topic, "topic")

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the fully qualified name of a service, remapped unless only expanded."""
        return self._full_name(service, "service") if only_expand else self._remapped(service, "service")

    @staticmethod
    def _profile(qos: QoSProfile | int) -> QoSProfile:
        if isinstance(qos, QoSProfile):
            return qos
        if isinstance(qos, bool) or not isinstance(qos, int):
            raise TypeError(f"Expected QoSProfile or int, but received {type(qos)!r}")
        if qos < 0:
            raise ValueError("history depth must be greater than or equal to zero")
        return QoSProfile(depth=qos)

    def _group(self, group: CallbackGroup | None) -> CallbackGroup:
        return group if group is not None else self._default_callback_group

    # -- making -----------------------------------------------------------------------------------------------

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
        profile = self._profile(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._remapped(topic, "topic")
        if qos_overriding_options is not None:
            profile = profile._copy()
            _declare_qos_parameters(Publisher, self, full, profile, qos_overriding_options)
        group = self._group(callback_group)
        made = publisher_class(self, msg_type, full, profile, event_callbacks or PublisherEventCallbacks(), group)
        self._publishers.append(made)
        self._adopt(made.event_handlers, group)
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
    ) -> Subscription:
        """Make a subscription; ``raw`` gives the callback the CDR bytes."""
        profile = self._profile(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._remapped(topic, "topic")
        if qos_overriding_options is not None:
            profile = profile._copy()
            _declare_qos_parameters(Subscription, self, full, profile, qos_overriding_options)
        group = self._group(callback_group)
        made = Subscription(
            self, msg_type, full, callback, group, profile, raw=raw,
            event_callbacks=event_callbacks or SubscriptionEventCallbacks(),
        )  # fmt: skip
        group.add_entity(made)
        self._subscriptions.append(made)
        self._adopt(made.event_handlers, group)
        self._changed()
        return made

    def _adopt(self, handlers: Sequence[Waitable], group: CallbackGroup) -> None:
        for handler in handlers:
            group.add_entity(handler)
            self._waitables.append(handler)
        self._changed()

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Make a client of a service."""
        check_is_valid_srv_type(srv_type)
        group = self._group(callback_group)
        made = Client(self, srv_type, self._remapped(srv_name, "service"), qos_profile, group)
        group.add_entity(made)
        self._clients.append(made)
        self._changed()
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
        group = self._group(callback_group)
        made = Service(self, srv_type, self._remapped(srv_name, "service"), callback, group, qos_profile)
        group.add_entity(made)
        self._services.append(made)
        self._changed()
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
        group = self._group(callback_group)
        made = Timer(callback, group, int(period), clock or self._clock, context=self._context, autostart=autostart)
        # Weakly: a node that is dropped takes its timers along.
        made._wake = functools.partial(_wake_node, weakref.ref(self))
        group.add_entity(made)
        self._timers.append(made)
        self._changed()
        return made

    def create_guard_condition(
        self, callback: Callable[[], Any], callback_group: CallbackGroup | None = None
    ) -> GuardCondition:
        """Make a guard condition."""
        group = self._group(callback_group)
        made = GuardCondition(callback, group, context=self._context)
        made._wake = self._wake
        group.add_entity(made)
        self._guards.append(made)
        self._changed()
        return made

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """Make a rate."""
        if frequency <= 0:
            raise ValueError("frequency must be > 0")
        made = Rate(
            self.create_timer(1.0 / frequency, None, MutuallyExclusiveCallbackGroup(), clock), context=self._context
        )
        self._rates.append(made)
        return made

    def add_waitable(self, waitable: Waitable) -> None:
        """Take a waitable on."""
        self._waitables.append(waitable)
        self._changed()

    def remove_waitable(self, waitable: Waitable) -> None:
        """Let a waitable go."""
        with contextlib.suppress(ValueError):
            self._waitables.remove(waitable)
        self._changed()

    # -- destroying -------------------------------------------------------------------------------------------

    def _remove(self, entities: list[Any], entity: Any) -> bool:
        if entity not in entities:
            return False
        entities.remove(entity)
        for handler in getattr(entity, "event_handlers", ()):
            self.remove_waitable(handler)
        entity.destroy()
        self._changed()
        return True

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Withdraw a publisher; return whether it was this node's."""
        return self._remove(self._publishers, publisher)

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Withdraw a subscription; return whether it was this node's."""
        return self._remove(self._subscriptions, subscription)

    def destroy_client(self, client: Client) -> bool:
        """Withdraw a client; return whether it was this node's."""
        return self._remove(self._clients, client)

    def destroy_service(self, service: Service) -> bool:
        """Withdraw a service; return whether it was this node's."""
        return self._remove(self._services, service)

    def destroy_timer(self, timer: Timer) -> bool:
        """End a timer; return whether it was this node's."""
        return self._remove(self._timers, timer)

    def destroy_guard_condition(self, guard: GuardCondition) -> bool:
        """End a guard condition; return whether it was this node's."""
        return self._remove(self._guards, guard)

    def destroy_rate(self, rate: Rate) -> bool:
        """End a rate; return whether it was this node's."""
        if rate not in self._rates:
            return False
        self._rates.remove(rate)
        self.destroy_timer(rate._timer)
        rate.destroy()
        return True

    def destroy_node(self) -> None:
        """Withdraw the node with all it owns."""
        if self._destroyed:
            return
        self._destroyed = True
        if (executor := self.executor) is not None:
            executor.remove_node(self)
        if self._rosout is not None:
            rcutils_logger.remove_sink(self._logger_name, self._to_rosout)
            self._rosout.destroy()
        for rate in list(self._rates):
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
                self._remove(entities, entity)
        for waitable in list(self._waitables):
            if hasattr(waitable, "destroy"):
                waitable.destroy()
        self._waitables.clear()
        self._changed()
        self._context._graph.remove(self._token_key)
        self._link.withdraw(self._token)

    def destroy(self) -> None:
        """Withdraw the node with all it owns."""
        self.destroy_node()

    # -- rosout -----------------------------------------------------------------------------------------------

    def _start_rosout(self, qos: QoSProfile | int) -> None:
        from rcl_interfaces.msg import Log  # noqa: PLC0415  classes are made on first use

        name, profile = self._remapped("/rosout", "topic"), self._profile(qos)
        self._rosout = Publisher(self, Log, name, profile, _SILENT, self._default_callback_group)
        rcutils_logger.add_sink(self._logger_name, self._to_rosout)

    def _to_rosout(self, stamp_ns: float, severity: int, name: str, text: str, caller: CallerId) -> None:
        if self._rosout is None or not self._context._ok:
            return
        log = self._rosout.msg_type(
            level=int(severity), name=name, msg=text.encode(errors="replace").decode(), file=caller.file_path,
            function=caller.function_name, line=caller.line_number,
        )  # fmt: skip
        log.stamp.sec, log.stamp.nanosec = divmod(int(stamp_ns), S_TO_NS)
        self._rosout.publish(log)


def _wake_node(reference: weakref.ref[Node]) -> None:
    node = reference()
    if node is not None:
        node._wake()


_SILENT = PublisherEventCallbacks(use_default_callbacks=False)
