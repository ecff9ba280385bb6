# SPDX-License-Identifier: Apache-2.0
"""The name under which rclpy's own modules know its C extension; here the few names of it that exist."""

from rclpy import _rclpy_pybind11 as rclpy_implementation

__all__ = ["rclpy_implementation"]
