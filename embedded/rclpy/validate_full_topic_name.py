# SPDX-License-Identifier: Apache-2.0
"""Checks fully qualified topic and service names."""

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException

from embedded_ros import names


def validate_full_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Return True, or raise with what is wrong and where."""
    problem = names.full_topic_problem(name)
    if problem is not None:
        raise (InvalidServiceNameException if is_service else InvalidTopicNameException)(name, *problem)
    return True
