# SPDX-License-Identifier: Apache-2.0
"""Checks topic and service names as typed."""

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException

from embedded_ros import names

TOPIC_SEPARATOR_STRING = "/"


def validate_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Return True, or raise with what is wrong and where."""
    problem = names.topic_problem(name)
    if problem is not None:
        raise (InvalidServiceNameException if is_service else InvalidTopicNameException)(name, *problem)
    return True
