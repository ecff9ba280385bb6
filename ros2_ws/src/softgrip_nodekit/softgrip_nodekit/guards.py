# SPDX-License-Identifier: Apache-2.0
"""What `run` adds to each node: requests that rclpy would let end it, and times that it must not live in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_nodekit.cell_time import USE_SIM_TIME, is_simulated
from softgrip_nodekit.errors import StartupError
from softgrip_nodekit.node import CellNode

if TYPE_CHECKING:
    from rclpy.parameter import Parameter


class _SetRequest(Protocol):
    """A request of either service that sets parameters."""

    @property
    def parameters(self) -> Sequence[ParameterMessage]:
        """What is to be set."""


_Request = TypeVar("_Request", bound=_SetRequest)
_Response = TypeVar("_Response")

#: The service by which a node shows that its executor works through its callbacks.
PING = "~/ping"


def serve_ping(node: Node) -> None:
    """Answer ``~/ping`` (std_srvs/Trigger) from the node's default callback group: what blocks it blocks the answer."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response

    node.create_service(Trigger, PING, answer)


def guard_parameter_services(node: Node) -> None:
    """Refuse values of a type that no parameter has: over such a one rclpy's own callback raises, unanswered."""
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _checked(service.callback, _refuse_each)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _checked(service.callback, _refuse_all)


def settle_time(node: CellNode) -> None:
    """Keep the node's kind of time: it is chosen at the start, and with real hardware it is the computer's.

    Raises:
        StartupError: simulated time was asked for, and the node has a device that is not emulated.
    """
    if is_simulated(node):
        real = [str(path) for path in node.device_paths if is_real_device(str(path))]
        if real:
            raise StartupError(
                f"{USE_SIM_TIME} is true, and {', '.join(real)} is real hardware, which knows no simulated time; "
                f"start it without {USE_SIM_TIME}, or with emulated hardware"
            )
    node.add_on_set_parameters_callback(_refuse_other_time)


def is_real_device(path: str) -> bool:
    """Whether a path names a device of this computer, not one that is emulated by a pseudo-terminal."""
    device = str(Path(path).resolve())
    return device.startswith("/dev/") and not device.startswith("/dev/pts/")


def _refuse_other_time(parameters: Sequence[Parameter]) -> SetParametersResult:
    if any(parameter.name == USE_SIM_TIME for parameter in parameters):
        reason = f"'{USE_SIM_TIME}' may be set at the start only: -p {USE_SIM_TIME}:=true; timers would stand still"
        return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True, reason="")


def _checked(
    callback: Callable[[_Request, _Response], _Response], refuse: Callable[[_Request, _Response, str], _Response]
) -> Callable[[_Request, _Response], _Response]:
    def checked(request: _Request, response: _Response) -> _Response:
        for parameter in request.parameters:
            kind = parameter.value.type
            if not ParameterType.PARAMETER_NOT_SET <= kind <= ParameterType.PARAMETER_STRING_ARRAY:
                last = ParameterType.PARAMETER_STRING_ARRAY
                reason = f"parameter '{parameter.name}': expected a type 0 .. {last}, found {kind}"
                return refuse(request, response, reason)
        return callback(request, response)

    return checked


def _refuse_each(
    request: SetParameters.Request, response: SetParameters.Response, reason: str
) -> SetParameters.Response:
    response.results = [SetParametersResult(successful=False, reason=reason) for _ in request.parameters]
    return response


def _refuse_all(
    _: SetParametersAtomically.Request, response: SetParametersAtomically.Response, reason: str
) -> SetParametersAtomically.Response:
    response.result = SetParametersResult(successful=False, reason=reason)
    return response
