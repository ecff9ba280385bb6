# SPDX-License-Identifier: Apache-2.0
"""Checks parameter names."""

from rclpy.exceptions import InvalidParameterException


def validate_parameter_name(name: str) -> bool:
    """Return True, or raise."""
    if not isinstance(name, str) or not name:
        raise InvalidParameterException(name)
    return True
