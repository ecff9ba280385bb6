# SPDX-License-Identifier: Apache-2.0
"""Guard conditions: run a callback in the executor because code said so."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.destroyable import Destroyable
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context


class GuardCondition(Destroyable):
    """Made by ``Node.create_guard_condition``."""

    def __init__(
        self, callback: Callable[[], Any] | None, callback_group: CallbackGroup | None, context: Context | None = None
    ) -> None:
        self._context = context or get_default_context()
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False
        self._triggered = False
        self._wake: Callable[[], None] = lambda: None

    def trigger(self) -> None:
        """Make the executor run the callback."""
        self._triggered = True
        self._wake()

    def _is_ready(self) -> bool:
        return self._triggered

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        self._triggered = False
        return (self.callback, ()) if self.callback is not None else None
