# SPDX-License-Identifier: Apache-2.0
"""Refused: service introspection."""

from embedded_ros.errors import needs_ros2

raise needs_ros2("service introspection")
