# SPDX-License-Identifier: Apache-2.0
"""Expands relative and private names."""

from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name

from embedded_ros import names


def expand_topic_name(topic_name: str, node_name: str, node_namespace: str) -> str:
    """Return the fully qualified name; ValueError when a part is not valid."""
    problem = names.topic_problem(topic_name)
    if problem is not None:
        raise ValueError(f"topic name is invalid: {problem[0]}")
    try:
        validate_node_name(node_name)
        validate_namespace(node_namespace)
    except Exception as error:
        raise ValueError(str(error)) from error
    try:
        return names.expand(topic_name, node_name, node_namespace)
    except KeyError as error:
        raise ValueError(f"unknown substitution {error} in {topic_name!r}") from None
