# SPDX-License-Identifier: Apache-2.0
"""Checks node names."""

from rclpy.exceptions import InvalidNodeNameException

from embedded_ros import names


def validate_node_name(node_name: str) -> bool:
    """Return True, or raise with what is wrong and where."""
    problem = names.node_problem(node_name)
    if problem is not None:
        raise InvalidNodeNameException(node_name, *problem)
    return True
