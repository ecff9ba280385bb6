# SPDX-License-Identifier: Apache-2.0
"""Refused: the events executor."""

from embedded_ros.errors import needs_ros2

raise needs_ros2("EventsExecutor")
