# SPDX-License-Identifier: Apache-2.0
"""What executors run, one piece at a time, and how their waiting ends."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rclpy.task import Task

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from rclpy.executors import Executor
    from rclpy.node import Node


class TimeoutException(Exception):  # noqa: N818  rclpy's name, as those below
    """Nothing became ready in time."""


class ShutdownException(Exception):  # noqa: N818
    """The executor was shut down."""


class ExternalShutdownException(Exception):  # noqa: N818
    """The context was shut down from outside, such as by SIGTERM."""

    def __init__(self) -> None:
        super().__init__()


class ConditionReachedException(Exception):  # noqa: N818
    """What was waited for is there."""


class TimeoutObject:
    """A timeout that starts to run when it is first asked."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._end: float | None = None

    @property
    def timeout(self) -> float:
        """Seconds left."""
        now = time.monotonic()
        if self._end is None:
            self._end = now + self._timeout
        return max(0.0, self._end - now)


class Work:
    """What an entity had ready: callback, arguments, and maybe what to do with the result."""

    __slots__ = ("entity", "executor", "node", "taken")

    def __init__(self, executor: Executor, entity: Any, node: Node) -> None:
        self.executor = executor
        self.entity = entity
        self.node = node
        self.taken: tuple[Any, ...] = (nothing, ())

    def finish(self) -> None:
        """Give the entity and its group back."""
        entity = self.entity
        entity._executor_event = False
        group = entity.callback_group
        if group is not None:
            group.ending_execution(entity)
        if self.executor._others_wait:
            self.executor.wake()


class Continuation(Task):
    """A coroutine that a callback of an entity began; the entity is given back when it ends."""

    def __init__(
        self,
        executor: Executor,
        coroutine: Coroutine[Any, Any, Any],
        work: Work,
        done: tuple[Callable[[Any], None], ...],
    ) -> None:
        super().__init__(nothing, executor=executor)
        self._handler = coroutine
        self._work: Work | None = work
        self._use_result = done

    def __call__(self) -> None:
        """Run one step."""
        super().__call__()
        if self._pending_is_over() and self._work is not None:
            work, self._work = self._work, None
            try:
                if self._use_result and self._exception is None and not self._cancelled:
                    self._use_result[0](self._result)
            except Exception as error:  # noqa: BLE001  raised where the task's result is asked for
                self.set_exception(error)
            finally:
                work.finish()
                work.executor.wake()


def nothing() -> None:
    """Stand for work that is gone when it is looked at."""
