# SPDX-License-Identifier: Apache-2.0
"""A client of another node's parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from rclpy.qos import QoSProfile, qos_profile_parameter_events, qos_profile_services_default

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rclpy.task import Future

_LOOK_PERIOD_S = 0.05


def _messages(parameters: Sequence[Any]) -> list[Any]:
    return [item.to_parameter_msg() if isinstance(item, Parameter) else item for item in parameters]


class AsyncParameterClient:
    """Asks the parameter services of a node; each call returns a future."""

    def __init__(
        self,
        node: Node,
        remote_node_name: str,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        from rcl_interfaces import srv  # noqa: PLC0415  classes are made on first use

        self.remote_node_name = remote_node_name
        self.node = node
        self._clients = {
            kind: node.create_client(
                kind, f"{remote_node_name}/{name}", qos_profile=qos_profile, callback_group=callback_group
            )
            for kind, name in (
                (srv.GetParameters, "get_parameters"),
                (srv.ListParameters, "list_parameters"),
                (srv.SetParameters, "set_parameters"),
                (srv.GetParameterTypes, "get_parameter_types"),
                (srv.DescribeParameters, "describe_parameters"),
                (srv.SetParametersAtomically, "set_parameters_atomically"),
            )
        }
        self._srv = srv

    def services_are_ready(self) -> bool:
        """Whether all six services are up."""
        return all(client.service_is_ready() for client in self._clients.values())

    def _ask(self, kind: Any, callback: Callable[[Future[Any]], Any] | None, **fields: Any) -> Future[Any]:
        future = self._clients[kind].call_async(kind.Request(**fields))
        if callback:
            future.add_done_callback(callback)
        return future

    def list_parameters(
        self,
        prefixes: list[str] | None = None,
        depth: int | None = None,
        callback: Callable[[Future[Any]], Any] | None = None,
    ) -> Future[Any]:
        """List names."""
        return self._ask(self._srv.ListParameters, callback, prefixes=prefixes or [], depth=depth or 0)

    def get_parameters(self, names: list[str], callback: Callable[[Future[Any]], Any] | None = None) -> Future[Any]:
        """Get values."""
        return self._ask(self._srv.GetParameters, callback, names=names)

    def set_parameters(
        self, parameters: Sequence[Any], callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Set values one by one."""
        return self._ask(self._srv.SetParameters, callback, parameters=_messages(parameters))

    def describe_parameters(
        self, names: list[str], callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Get descriptors."""
        return self._ask(self._srv.DescribeParameters, callback, names=names)

    def get_parameter_types(
        self, names: list[str], callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Get types."""
        return self._ask(self._srv.GetParameterTypes, callback, names=names)

    def set_parameters_atomically(
        self, parameters: Sequence[Any], callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Set all values or none."""
        return self._ask(self._srv.SetParametersAtomically, callback, parameters=_messages(parameters))

    def delete_parameters(self, names: list[str], callback: Callable[[Future[Any]], Any] | None = None) -> Future[Any]:
        """Unset parameters that are dynamically typed."""
        return self.set_parameters([Parameter(name) for name in names], callback)

    def load_parameter_file(
        self, parameter_file: str, use_wildcard: bool = False, callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Set what a file says."""
        return self.set_parameters(list(parameter_dict_from_yaml_file(parameter_file, use_wildcard).values()), callback)

    def load_parameter_file_atomically(
        self, parameter_file: str, use_wildcard: bool = False, callback: Callable[[Future[Any]], Any] | None = None
    ) -> Future[Any]:
        """Set all that a file says, or nothing."""
        values = parameter_dict_from_yaml_file(parameter_file, use_wildcard).values()
        return self.set_parameters_atomically(list(values), callback)

    def on_parameter_event(
        self,
        callback: Callable[[Any], Any],
        qos_profile: QoSProfile = qos_profile_parameter_events,
        **options: Any,
    ) -> Subscription:
        """Subscribe to /parameter_events; the options are those of ``create_subscription``."""
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        return self.node.create_subscription(ParameterEvent, "/parameter_events", callback, qos_profile, **options)
