# SPDX-License-Identifier: Apache-2.0
"""How an executor waits, and how it finds what has become ready."""

from __future__ import annotations

import collections
import contextlib
import sys
import threading
import time
import traceback
from typing import TYPE_CHECKING, Any, cast

from rclpy.endpoint import Endpoint
from rclpy.executor_work import (
    ConditionReachedException,
    ExternalShutdownException,
    ShutdownException,
    TimeoutException,
    TimeoutObject,
    Work,
)
from rclpy.task import Task

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.context import Context
    from rclpy.executors import Executor
    from rclpy.node import Node
    from rclpy.timer import Timer
    from rclpy.waitable import Waitable

# Windows does not interrupt a waiting lock for Ctrl-C.
LONGEST_WAIT_S = 0.1 if sys.platform == "win32" else 3600.0
_LOOK_PERIOD_S = 0.1
_LOOK_AT_NEW_NODE_S = 0.001
# Where messages come faster than that, Zenoh's thread and the executor's would hand Python to each other at each one.
_FLOOD = 50
_FLOOD_PERIOD_S = 0.01
_GATHER_S = 0.0002


class Waiting:
    """The waiting part of executors."""

    _context: Context
    _is_shutdown: bool

    def __init__(self) -> None:
        self._nodes: set[Node] = set()
        self._pending_tasks: dict[Task, tuple[Any, Any]] = {}
        self._ready_tasks: collections.deque[Task] = collections.deque()
        self._callbacks: Iterator[Task | Work] | None = None
        self._hints: collections.deque[tuple[Any, Node]] = collections.deque()
        self._due_s = 0.0  # when the next timer is due, as of the last look; whatever changes that wants a look
        self._look_due_s = 0.0
        self._looked_s = 0.0
        self._poll_requested = True
        self._node_came = True
        self._hinted_count = 0
        self._flood_judged_s = 0.0
        self._is_flood = False
        # A lock that stays locked: acquiring it waits, releasing it wakes. Nothing in Python waits cheaper.
        self._wake_lock = threading.Lock()
        self._wake_lock.acquire()

    def get_nodes(self) -> list[Node]:
        """Return the nodes."""
        raise NotImplementedError

    def _execute(self, work: Work) -> None:
        raise NotImplementedError

    def _itself(self) -> Executor:
        return cast("Executor", self)

    def wake(self) -> None:
        """Have the waiting thread look at everything again."""
        self._poll_requested = True
        self._end_wait()

    def _hint(self, entity: Any, node: Node) -> None:
        """Say that an entity has become ready: the waiting thread need not look for it among all."""
        self._hints.append((entity, node))
        self._end_wait()

    def _end_wait(self) -> None:
        try:
            self._wake_lock.release()
        except RuntimeError:
            return  # it has been woken already

    def can_execute(self, entity: Any) -> bool:
        """Whether an entity is not being run and its group lets it."""
        group = entity.callback_group
        return not entity._executor_event and (group is None or bool(group.can_execute(entity)))

    def wait_for_ready_callbacks(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        nodes: list[Node] | None = None,
        condition: Callable[[], bool] | None = None,
    ) -> tuple[Task, Any, Node | None]:
        """Return the next (task, entity, node) that is ready.

        Raises:
            TimeoutException, ShutdownException, ExternalShutdownException, ConditionReachedException: instead.
        """
        item = self._next(timeout_sec, nodes, condition)
        if isinstance(item, Work):
            return Task(self._execute, (item,), executor=self._itself()), item.entity, item.node
        return item, *self._pending_tasks.get(item, (None, None))

    def _next(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        nodes: list[Node] | None = None,
        condition: Callable[[], bool] | None = None,
    ) -> Task | Work:
        """Wait for what is to be run next."""
        if isinstance(timeout_sec, TimeoutObject):
            timeout_sec = timeout_sec.timeout
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        while True:
            if self._is_shutdown:
                raise ShutdownException
            if not self._context._ok:
                raise ExternalShutdownException
            if condition is not None and condition():
                raise ConditionReachedException
            found = self._next_ready(nodes)
            if found is not None:
                return found
            self._wait(end)

    def _next_ready(self, nodes: list[Node] | None) -> Task | Work | None:
        """Return work, going round: all that was ready at one look comes before a second look.

        What has just become ready says so itself and is run without a look. Looks come when a timer is due, when there
        is a task (an action that was just accepted runs before its client hears of that, as in rclpy), when somebody
        wants one, and every tenth of a second.
        """
        if self._callbacks is not None:
            found = next(self._callbacks, None)
            if found is not None:
                return found
            self._callbacks = None
        now = time.monotonic()
        if nodes is None and self._look_can_wait(now):
            hinted = self._hinted()
            if hinted is not None or not self._node_came:
                return hinted
        self._poll_requested = nodes is not None  # a look at some is none at all
        self._node_came = False
        self._looked_s = now
        self._due_s = now + self._seconds_until_due(LONGEST_WAIT_S, nodes)
        self._look_due_s = min(self._due_s, now + _LOOK_PERIOD_S)
        self._callbacks = self._look(nodes)
        found = next(self._callbacks, None)
        if found is None:
            self._callbacks = None
        return found

    def _look_can_wait(self, now: float) -> bool:
        if self._poll_requested or self._ready_tasks:
            return False
        # ``spin_once`` adds its node anew each time: it is looked at before any waiting, but not at every message.
        return now < self._look_due_s and (not self._node_came or now < self._looked_s + _LOOK_AT_NEW_NODE_S)

    def _hinted(self) -> Work | None:
        while self._hints:
            try:
                entity, node = self._hints.popleft()
            except IndexError:
                return None
            if node in self._nodes and not entity._executor_event:
                work = self._taken(entity, node)
                if work is not None:
                    self._hinted_count += 1
                    return work
        return None

    def _look(self, nodes: list[Node] | None) -> Iterator[Task | Work]:
        for _ in range(len(self._ready_tasks)):
            with contextlib.suppress(IndexError):
                task = self._ready_tasks.popleft()
                _, owner = self._pending_tasks.get(task, (None, None))
                if nodes is None or owner is None or owner in nodes:
                    yield task
                else:
                    self._ready_tasks.append(task)
        for node in nodes if nodes is not None else self.get_nodes():
            for entity in node._rcl_entities():
                if entity._is_ready() and self.can_execute(entity):
                    work = self._taken(entity, node)
                    if work is not None:
                        if not isinstance(entity, Endpoint):
                            self._poll_requested = True  # it may have more; endpoints say so themselves
                        yield work

    def _taken(self, entity: Any, node: Node) -> Work | None:
        """Take what an entity has; None when another thread was faster or it was garbage."""
        group = entity.callback_group
        entity._executor_event = True
        if group is not None and not group.beginning_execution(entity):
            entity._executor_event = False
            return None
        work = Work(self._itself(), entity, node)
        try:
            taken = entity._take()
        except Exception as error:  # noqa: BLE001  a fault of this package over what arrived must not end the node
            taken = None
            if node._rcl_throttle.admit((entity, type(error))) is not None:
                node.get_logger().error(f"could not take what arrived: {traceback.format_exc()}")
        if taken is None:
            work.finish()
            return None
        work.taken = taken
        return work

    def _wait(self, end: float | None) -> None:
        now = time.monotonic()
        limit = min(LONGEST_WAIT_S, self._due_s - now)
        if end is not None:
            if end <= now:
                raise TimeoutException
            limit = min(limit, end - now)
        if self._ready_tasks or limit <= 0:
            self._poll_requested = True
            return
        if now > self._flood_judged_s + _FLOOD_PERIOD_S:
            self._is_flood = self._hinted_count > _FLOOD
            self._hinted_count, self._flood_judged_s = 0, now
        if self._is_flood:
            time.sleep(min(_GATHER_S, limit))
        self._wake_lock.acquire(timeout=limit)

    def _seconds_until_due(self, limit: float, nodes: list[Node] | None) -> float:
        """Return when the next timer that may run is due, at most ``limit`` [s]."""
        for node in nodes if nodes is not None else self.get_nodes():
            everything: list[Timer | Waitable] = [*node._timers, *node._rcl_waitables]
            for timed in everything:
                due = timed._seconds_until_due()
                if due is not None and due < limit and self.can_execute(timed):
                    limit = due
        return limit
