# SPDX-License-Identifier: Apache-2.0
"""The former name of :mod:`rclpy.event_handler`."""

from rclpy.event_handler import *  # noqa: F403  the same names under the old path
