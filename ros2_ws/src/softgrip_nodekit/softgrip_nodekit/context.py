# SPDX-License-Identifier: Apache-2.0
"""The end of a ROS context."""

from __future__ import annotations

import contextlib

import rclpy
from rclpy.context import Context


def end_context(context: Context | None = None) -> None:
    """Shut a context down if it is not down yet; None = the one that `rclpy.init` made.

    `try_shutdown` looks and then shuts down; where a signal's thread does so in between, rcl refuses the second
    time ("rcl_shutdown already called"). What is wanted has happened then, and the caller may have hardware to make
    safe.
    """
    with contextlib.suppress(RuntimeError):
        if context is None:
            rclpy.try_shutdown()
        else:
            context.try_shutdown()
