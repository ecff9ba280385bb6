# SPDX-License-Identifier: Apache-2.0
"""The service ``~/get_type_description`` that each node has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_services_default

from embedded_ros.errors import EmbeddedError
from embedded_ros.registry import registry

if TYPE_CHECKING:
    from rclpy.node import Node

START_TYPE_DESCRIPTION_SERVICE_PARAM = "start_type_description_service"


class TypeDescriptionService:
    """Belongs to a node; the parameter ``start_type_description_service`` turns it off."""

    def __init__(self, node: Node) -> None:
        from rcl_interfaces.msg import ParameterDescriptor, ParameterType  # noqa: PLC0415  classes are made on first use
        from type_description_interfaces.srv import GetTypeDescription  # noqa: PLC0415  as above

        self._service = None
        name = START_TYPE_DESCRIPTION_SERVICE_PARAM
        if not node.has_parameter(name):
            descriptor = ParameterDescriptor(
                name=name, type=ParameterType.PARAMETER_BOOL, read_only=True,
                description="Start the ~/get_type_description service for this node.",
            )  # fmt: skip
            node.declare_parameter(name, True, descriptor)
        value = node.get_parameter(name)
        if value.type_ is not Parameter.Type.BOOL:
            raise ValueError(f"Invalid type for parameter '{name}' {value.type_!r} should be bool")
        if value.value:
            self._service = node.create_service(
                GetTypeDescription, "~/get_type_description", self._answer,
                qos_profile=qos_profile_services_default, callback_group=MutuallyExclusiveCallbackGroup(),
            )  # fmt: skip

    @staticmethod
    def _answer(request: Any, response: Any) -> Any:
        try:
            interface = registry().interface(request.type_name)
        except EmbeddedError as error:
            response.failure_reason = str(error)
            return response
        if request.type_hash and request.type_hash != interface.DEFINITION.type_hash:
            response.failure_reason = f"the type has the hash {interface.DEFINITION.type_hash} here"
            return response
        response.successful = True
        _fill(response.type_description, interface.DEFINITION.description)
        return response


def _fill(target: Any, source: dict[str, Any]) -> None:
    from type_description_interfaces.msg import Field, IndividualTypeDescription  # noqa: PLC0415  on first use

    def individual(item: dict[str, Any]) -> Any:
        result = IndividualTypeDescription(type_name=item["type_name"])
        for part in item["fields"]:
            field = Field(name=part["name"])
            field.type.type_id = part["type"]["type_id"]
            field.type.capacity = part["type"]["capacity"]
            field.type.string_capacity = part["type"]["string_capacity"]
            field.type.nested_type_name = part["type"]["nested_type_name"]
            result.fields.append(field)
        return result

    target.type_description = individual(source["type_description"])
    target.referenced_type_descriptions = [individual(item) for item in source["referenced_type_descriptions"]]
