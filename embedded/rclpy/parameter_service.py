# SPDX-License-Identifier: Apache-2.0
"""The six parameter services of a node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters

if TYPE_CHECKING:
    from rclpy.node import Node


#: What a value that cannot be raises; Jazzy's rclpy lets it end the node.
_REFUSALS = (AttributeError, TypeError, ValueError)


class ParameterService:
    """Belongs to a node."""

    def __init__(self, node: Node) -> None:
        import rcl_interfaces.srv as srv  # noqa: PLC0415, PLR0402  classes are made on first use

        self._node = node
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, callback in (
            (srv.DescribeParameters, "describe_parameters", self._describe),
            (srv.GetParameters, "get_parameters", self._get),
            (srv.GetParameterTypes, "get_parameter_types", self._types),
            (srv.ListParameters, "list_parameters", self._list),
            (srv.SetParameters, "set_parameters", self._set),
            (srv.SetParametersAtomically, "set_parameters_atomically", self._set_atomically),
        ):
            node.create_service(kind, f"~/{name}", callback, qos_profile=qos_profile_parameters, callback_group=group)

    def _describe(self, request: Any, response: Any) -> Any:
        for name in request.names:
            try:
                response.descriptors.append(self._node.describe_parameter(name))
            except ParameterNotDeclaredException:
                response.descriptors = []
                return response
        return response

    def _get(self, request: Any, response: Any) -> Any:
        for name in request.names:
            try:
                response.values.append(self._node.get_parameter(name).get_parameter_value())
            except (ParameterNotDeclaredException, ParameterUninitializedException):
                response.values = []
                return response
        return response

    def _types(self, request: Any, response: Any) -> Any:
        for name in request.names:
            try:
                response.types.append(self._node.get_parameter_type(name).value)
            except ParameterNotDeclaredException:
                response.types = []
                return response
        return response

    def _list(self, request: Any, response: Any) -> Any:
        try:
            response.result = self._node.list_parameters(list(request.prefixes), request.depth)
        except (TypeError, ValueError) as error:
            self._node.get_logger().warning(f"Failed to list parameters: {error}")
        return response

    def _set(self, request: Any, response: Any) -> Any:
        from rcl_interfaces.msg import SetParametersResult  # noqa: PLC0415  classes are made on first use

        for message in request.parameters:
            try:
                result = self._node.set_parameters_atomically([Parameter.from_parameter_msg(message)])
            except (ParameterNotDeclaredException, *_REFUSALS) as error:
                result = SetParametersResult(successful=False, reason=str(error))
            response.results.append(result)
        return response

    def _set_atomically(self, request: Any, response: Any) -> Any:
        from rcl_interfaces.msg import SetParametersResult  # noqa: PLC0415  classes are made on first use

        try:
            parameters = [Parameter.from_parameter_msg(message) for message in request.parameters]
            response.result = self._node.set_parameters_atomically(parameters)
        except (ParameterNotDeclaredException, *_REFUSALS) as error:
            response.result = SetParametersResult(successful=False, reason=str(error))
        return response
