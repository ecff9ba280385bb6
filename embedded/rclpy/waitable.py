# SPDX-License-Identifier: Apache-2.0
"""Entities of several kinds of work. Only rclpy's own (actions, events) exist here: there is no C wait set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup


class Waitable:
    """Base of the entities that the executor asks by ``_is_ready`` and ``_take``."""

    def __init__(self, callback_group: CallbackGroup) -> None:
        self.callback_group = callback_group
        self._executor_event = False

    def _is_ready(self) -> bool:
        raise NotImplementedError

    def _seconds_until_due(self) -> float | None:
        """Return real seconds until it is ready by itself; None when it waits for others."""
        return None

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        raise NotImplementedError


class NumberOfEntities:
    """Refused: there is no wait set."""

    def __init__(self, *_: object, **__: object) -> None:
        from embedded_ros.errors import needs_ros2  # noqa: PLC0415  only for the refusal

        raise needs_ros2("a custom Waitable on a C wait set")
