# SPDX-License-Identifier: Apache-2.0
"""Checks namespaces."""

from rclpy.exceptions import InvalidNamespaceException

from embedded_ros import names


def validate_namespace(namespace: str) -> bool:
    """Return True, or raise with what is wrong and where."""
    problem = names.namespace_problem(namespace)
    if problem is not None:
        raise InvalidNamespaceException(namespace, *problem)
    return True
