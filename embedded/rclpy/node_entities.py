# SPDX-License-Identifier: Apache-2.0
"""What a node owns: made, listed, destroyed."""

from __future__ import annotations

import contextlib
import functools
import math
import weakref
from typing import TYPE_CHECKING, Any, cast

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.constants import S_TO_NS
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.guard_condition import GuardCondition
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, qos_profile_services_default
from rclpy.qos_overriding_options import QoSOverridingOptions, _declare_qos_parameters
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Rate, Timer
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type

from embedded_ros.errors import needs_ros2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.waitable import Waitable


class NodeEntities:
    """Publishers, subscriptions, clients, services, timers, guard conditions, waitables; mixed into Node."""

    _context: Context
    _clock: Clock
    _default_callback_group: CallbackGroup

    def _rcl_init_entities(self) -> None:
        self._publishers: list[Publisher] = []
        self._subscriptions: list[Subscription] = []
        self._clients: list[Client] = []
        self._services: list[Service] = []
        self._timers: list[Timer] = []
        self._guards: list[GuardCondition] = []
        self._rcl_waitables: list[Waitable] = []
        self._rcl_rates: list[Rate] = []
        self._rcl_entity_list: list[Any] | None = None

    def _rcl_node(self) -> Node:
        return cast("Node", self)

    def _rcl_remapped(self, name: str, kind: str) -> str:
        raise NotImplementedError

    def _rcl_wake(self) -> None:
        raise NotImplementedError

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
        """Have the executor see that an entity came or went."""
        self._rcl_entity_list = None
        self._rcl_wake()

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
        profile = self._rcl_profile(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._rcl_remapped(topic, "topic")
        if qos_overriding_options is not None:
            profile = profile._copy()
            _declare_qos_parameters(Publisher, self._rcl_node(), full, profile, qos_overriding_options)
        group = self._rcl_group(callback_group)
        made = publisher_class(
            self._rcl_node(), msg_type, topic, profile, event_callbacks or PublisherEventCallbacks(), group, name=full
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
            _declare_qos_parameters(Subscription, self._rcl_node(), full, profile, qos_overriding_options)
        group = self._rcl_group(callback_group)
        made = Subscription(
            self._rcl_node(), msg_type, topic, callback, group, profile, raw=raw,
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
    ) -> Client:
        """Make a client of a service."""
        check_is_valid_srv_type(srv_type)
        group = self._rcl_group(callback_group)
        made = Client(self._rcl_node(), srv_type, self._rcl_remapped(srv_name, "service"), qos_profile, group)
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
        made = Service(
            self._rcl_node(), srv_type, self._rcl_remapped(srv_name, "service"), callback, group, qos_profile
        )
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
        made._wake = functools.partial(_wake_node, weakref.ref(self._rcl_node()))
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

    # -- destroying -------------------------------------------------------------------------------------------

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

    def destroy_client(self, client: Client) -> bool:
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


def _wake_node(reference: weakref.ref[Node]) -> None:
    node = reference()
    if node is not None:
        node._rcl_wake()
