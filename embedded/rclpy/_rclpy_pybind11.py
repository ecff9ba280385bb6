# SPDX-License-Identifier: Apache-2.0
"""The few names of rclpy's C extension that node code catches."""

from __future__ import annotations

from rclpy.exceptions import InvalidHandle

__all__ = ["InvalidHandle", "NodeNameNonExistentError", "RCLError", "RCLInvalidROSArgsError", "UnknownROSArgsError"]


class RCLError(RuntimeError):
    """An operation the middleware refused."""


class RCLInvalidROSArgsError(RCLError):
    """``--ros-args`` holds something wrong."""


class UnknownROSArgsError(RuntimeError):
    """``--ros-args`` holds something unknown."""


class NodeNameNonExistentError(RCLError):
    """No node of this name is up."""
