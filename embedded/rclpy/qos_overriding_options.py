# SPDX-License-Identifier: Apache-2.0
"""QoS that parameters may override."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.exceptions import ParameterAlreadyDeclaredException
from rclpy.qos import QoSPolicyEnum, QoSPolicyKind, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.node import Node


class InvalidQosOverridesError(Exception):
    """The overrides make a profile that the callback refuses."""


class QosCallbackResult:
    """What the validation callback returns."""

    def __init__(self) -> None:
        self.successful = False
        self.reason = ""


class QoSOverridingOptions:
    """Which policies may be overridden, by which parameters."""

    def __init__(
        self,
        policy_kinds: Iterable[QoSPolicyKind],
        *,
        callback: Callable[[QoSProfile], Any] | None = None,
        entity_id: str | None = None,
    ) -> None:
        self._policy_kinds = tuple(policy_kinds)
        self._callback = callback
        self._entity_id = entity_id

    @property
    def policy_kinds(self) -> tuple[QoSPolicyKind, ...]:
        """The policies."""
        return self._policy_kinds

    @property
    def callback(self) -> Callable[[QoSProfile], Any] | None:
        """Checks the profile that comes out."""
        return self._callback

    @property
    def entity_id(self) -> str | None:
        """Tells publishers or subscriptions of one topic apart."""
        return self._entity_id

    @classmethod
    def with_default_policies(
        cls, *, callback: Callable[[QoSProfile], Any] | None = None, entity_id: str | None = None
    ) -> QoSOverridingOptions:
        """Return options for history, depth and reliability."""
        kinds = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY)
        return cls(kinds, callback=callback, entity_id=entity_id)


def _declare_qos_parameters(
    entity_type: type, node: Node, topic_name: str, qos: QoSProfile, options: QoSOverridingOptions
) -> None:
    """Declare ``qos_overrides.<topic>.<publisher|subscription>[_id].<policy>`` and put their values into ``qos``."""
    from rcl_interfaces.msg import ParameterDescriptor  # noqa: PLC0415  classes are made on first use

    suffix = f"_{options.entity_id}" if options.entity_id else ""
    prefix = f"qos_overrides.{topic_name}.{entity_type.__name__.lower()}{suffix}"
    for policy in options.policy_kinds:
        attribute = policy.name.lower()
        name = f"{prefix}.{attribute}"
        descriptor = ParameterDescriptor(name=name, description=f"qos policy {attribute}", read_only=True)
        try:
            value = node.declare_parameter(name, _get_qos_policy_parameter(qos, policy), descriptor).value
        except ParameterAlreadyDeclaredException:
            value = node.get_parameter(name).value
        try:
            setattr(qos, attribute, _like(getattr(qos, attribute), value))
        except (KeyError, ValueError, AssertionError) as error:
            raise InvalidQosOverridesError(f"{name}: {value!r} is no value of this policy") from error
    if options.callback is not None:
        verdict = options.callback(qos)
        if not verdict.successful:
            raise InvalidQosOverridesError(f"{topic_name}: QoS overrides refused: {verdict.reason}")


def _get_qos_policy_parameter(qos: QoSProfile, policy: QoSPolicyKind) -> Any:
    """Return the value of a policy as a parameter can hold it."""
    value = getattr(qos, policy.name.lower())
    if isinstance(value, QoSPolicyEnum):
        return value.short_key
    return value.nanoseconds if isinstance(value, Duration) else value


def _like(old: Any, value: Any) -> Any:
    if isinstance(old, QoSPolicyEnum):
        return type(old).get_from_short_key(value)
    return Duration(nanoseconds=value) if isinstance(old, Duration) else value
