# SPDX-License-Identifier: Apache-2.0
"""Whether a value suits the descriptor of its parameter."""

from __future__ import annotations

import math
from typing import Any

from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter

REL_TOL = 1e-6


def problem(parameter: Parameter, descriptor: Any, *, declared: bool, check_read_only: bool) -> str:
    """Return why a value does not suit a descriptor; '' when it does. Completes the descriptor's name and type."""
    descriptor.name = parameter.name
    if check_read_only and descriptor.read_only:
        return f"Trying to set a read-only parameter: {parameter.name}."
    if descriptor.dynamic_typing:
        descriptor.type = parameter.type_.value
    elif parameter.type_ is Parameter.Type.NOT_SET:
        if declared:
            return "Static parameter cannot be undeclared"
    elif parameter.type_.value != descriptor.type:
        return f"Wrong parameter type, expected '{Parameter.Type(descriptor.type)}' got '{parameter.type_}'"
    if parameter.type_ is Parameter.Type.INTEGER and descriptor.integer_range:
        return _integer_problem(parameter, descriptor.integer_range[0])
    if parameter.type_ is Parameter.Type.DOUBLE and descriptor.floating_point_range:
        return _float_problem(parameter, descriptor.floating_point_range[0])
    return ""


def make_result(reason: str = "") -> Any:
    """Return the result of setting: refused when there is a reason."""
    from rcl_interfaces.msg import SetParametersResult  # noqa: PLC0415  classes are made on first use

    return SetParametersResult(successful=not reason, reason=reason)


def is_listed(name: str, prefixes: list[str], depth: int) -> bool:
    """Whether a name is within a depth (0 is any) of one of the prefixes (none is all)."""
    separator = PARAMETER_SEPARATOR_STRING
    rests = [name.removeprefix(prefix + separator) for prefix in prefixes if name.startswith(prefix + separator)]
    if name in prefixes:
        return True
    return any(depth == 0 or rest.count(separator) < depth for rest in (rests if prefixes else [name]))


def make_descriptor(*, dynamic_typing: bool = False) -> Any:
    """Return a fresh descriptor."""
    from rcl_interfaces.msg import ParameterDescriptor  # noqa: PLC0415  classes are made on first use

    return ParameterDescriptor(dynamic_typing=dynamic_typing)


def _integer_problem(parameter: Parameter, limits: Any) -> str:
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if value in {low, high}:
        return ""
    if not low < value < high:
        return f"Parameter {parameter.name} out of range. Min: {low}, Max: {high}, value: {value}"
    if limits.step and (value - low) % limits.step:
        return (
            f"The parameter value for {parameter.name} is not a valid step. "
            f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
        )
    return ""


def _float_problem(parameter: Parameter, limits: Any) -> str:
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if math.isclose(value, low, rel_tol=REL_TOL) or math.isclose(value, high, rel_tol=REL_TOL):
        return ""
    if not low < value < high:
        return f"Parameter {parameter.name} out of range Min: {low}, Max: {high}, value: {value}"
    if limits.step:
        nearest = low + round((value - low) / limits.step) * limits.step
        if not math.isclose(nearest, value, rel_tol=REL_TOL):
            return (
                f"The parameter value for {parameter.name} is not close enough to a valid step. "
                f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
            )
    return ""
