# SPDX-License-Identifier: Apache-2.0
"""Executors: wait until an entity of a node has work, run its callback."""

from __future__ import annotations

import collections
import concurrent.futures
import contextlib
import os
import sys
import threading
import time
import warnings
from typing import TYPE_CHECKING, Any

from rclpy.task import Future, Task
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from rclpy.context import Context
    from rclpy.node import Node

# Windows does not interrupt a waiting lock for Ctrl-C.
_LONGEST_WAIT_S = 0.1 if sys.platform == "win32" else 3600.0


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


class Executor:
    """Base of the executors."""

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = context or get_default_context()
        self._nodes: set[Node] = set()
        self._nodes_lock = threading.RLock()
        self._pending_tasks: dict[Task, tuple[Any, Any]] = {}
        self._ready_tasks: collections.deque[Task] = collections.deque()
        self._is_shutdown = False
        self._is_spinning = False
        self._spin_lock = threading.Lock()
        self._active: set[int] = set()
        self._idle = threading.Event()
        self._callbacks: Iterator[tuple[Task, Any, Node | None]] | None = None
        # A lock that stays locked: acquiring it waits, releasing it wakes. Nothing in Python waits cheaper.
        self._wake_lock = threading.Lock()
        self._wake_lock.acquire()
        self._context._wakers.add(self)

    @property
    def context(self) -> Context:
        """The context."""
        return self._context

    @property
    def is_spinning(self) -> bool:
        """Whether a thread is spinning it."""
        return self._is_spinning

    def wake(self) -> None:
        """Have the waiting thread look again."""
        with contextlib.suppress(RuntimeError):
            self._wake_lock.release()

    def _enter_spin(self) -> None:
        with self._spin_lock:
            if self._is_spinning:
                raise RuntimeError("Executor is already spinning")
            self._is_spinning = True

    def _exit_spin(self) -> None:
        self._is_spinning = False

    def create_task(self, callback: Callable[..., Any] | Coroutine[Any, Any, Any], *args: Any, **kwargs: Any) -> Task:
        """Run a function or coroutine in the executor; return the task, which is a future."""
        task = Task(callback, args, kwargs, executor=self)  # type: ignore[arg-type]
        self._pending_tasks[task] = (None, None)
        self._call_task_in_next_spin(task)
        return task

    def create_future(self) -> Future:
        """Return a future whose done callbacks run in this executor."""
        return Future(executor=self)

    def _call_task_in_next_spin(self, task: Task) -> None:
        self._ready_tasks.append(task)
        self.wake()

    def add_node(self, node: Node) -> bool:
        """Take a node on; return False when it was already."""
        with self._nodes_lock:
            if node in self._nodes:
                return False
            self._nodes.add(node)
            node.executor = self
        self.wake()
        return True

    def remove_node(self, node: Node) -> None:
        """Let a node go."""
        with self._nodes_lock:
            if node in self._nodes:
                self._nodes.discard(node)
        self.wake()

    def get_nodes(self) -> list[Node]:
        """Return the nodes."""
        with self._nodes_lock:
            return list(self._nodes)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop; return whether running callbacks ended in time."""
        self._is_shutdown = True
        self.wake()
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        # A callback may shut its own executor down: it does not wait for itself.
        while self._active - {threading.get_ident()}:
            if end is not None and time.monotonic() >= end:
                return False
            self._idle.clear()
            if self._active - {threading.get_ident()}:
                self._idle.wait(_LONGEST_WAIT_S if end is None else max(0.0, end - time.monotonic()))
        with self._nodes_lock:
            for node in list(self._nodes):
                self.remove_node(node)
        return True

    def __enter__(self) -> Executor:
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    # -- spinning ---------------------------------------------------------------------------------------------

    def spin(self) -> None:
        """Run callbacks until shutdown."""
        self._enter_spin()
        try:
            while self._context.ok() and not self._is_shutdown:
                self._spin_once_impl()
        finally:
            self._exit_spin()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, waiting for it no longer than the timeout."""
        self._enter_spin()
        try:
            self._spin_once_impl(timeout_sec)
        finally:
            self._exit_spin()

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is over or time is up."""
        self._enter_spin()
        try:
            future._add_waker(self.wake)
            if timeout_sec is None or timeout_sec < 0:
                while self._context.ok() and not future._pending_is_over() and not self._is_shutdown:
                    self._spin_once_impl(None, future._pending_is_over)
                return
            end = time.monotonic() + timeout_sec
            while self._context.ok() and not future._pending_is_over() and not self._is_shutdown:
                self._spin_once_impl(max(0.0, end - time.monotonic()), future._pending_is_over)
                if time.monotonic() >= end:
                    return
        finally:
            self._exit_spin()

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | TimeoutObject | None = None
    ) -> None:
        """Run one callback unless the future is over."""
        self._enter_spin()
        future._add_waker(self.wake)
        try:
            self._spin_once_impl(timeout_sec, future._pending_is_over)
        finally:
            self._exit_spin()

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] = lambda: False
    ) -> None:
        raise NotImplementedError

    # -- waiting ----------------------------------------------------------------------------------------------

    def can_execute(self, entity: Any) -> bool:
        """Whether an entity is not being run and its group lets it."""
        group = entity.callback_group
        return not entity._executor_event and (group is None or bool(group.can_execute(entity)))

    def wait_for_ready_callbacks(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        nodes: list[Node] | None = None,
        condition: Callable[[], bool] = lambda: False,
    ) -> tuple[Task, Any, Node | None]:
        """Return the next (task, entity, node) that is ready.

        Raises:
            TimeoutException, ShutdownException, ExternalShutdownException, ConditionReachedException: instead.
        """
        if isinstance(timeout_sec, TimeoutObject):
            timeout_sec = timeout_sec.timeout
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        while True:
            if self._is_shutdown:
                raise ShutdownException
            if not self._context._ok:
                raise ExternalShutdownException
            if condition():
                raise ConditionReachedException
            found = self._next_ready(nodes)
            if found is not None:
                return found
            self._wait(end, nodes)

    def _next_ready(self, nodes: list[Node] | None) -> tuple[Task, Any, Node | None] | None:
        """Return work, going round: all that was ready at one look comes before a second look."""
        for _ in range(2):
            if self._callbacks is None:
                self._callbacks = self._look(nodes)
            found = next(self._callbacks, None)
            if found is not None:
                return found
            self._callbacks = None
        return None

    def _look(self, nodes: list[Node] | None) -> Iterator[tuple[Task, Any, Node | None]]:
        for _ in range(len(self._ready_tasks)):
            with contextlib.suppress(IndexError):
                task = self._ready_tasks.popleft()
                entity, node = self._pending_tasks.get(task, (None, None))
                if nodes is None or node is None or node in nodes:
                    yield task, entity, node
                else:
                    self._ready_tasks.append(task)
        for node in nodes if nodes is not None else self.get_nodes():
            for entity in node._entities():
                if entity._is_ready() and self.can_execute(entity):
                    entity._executor_event = True
                    if entity.callback_group is not None and not entity.callback_group.beginning_execution(entity):
                        entity._executor_event = False
                        continue
                    yield self._made(entity, node), entity, node

    def _wait(self, end: float | None, nodes: list[Node] | None) -> None:
        now = time.monotonic()
        if end is not None and now >= end:
            raise TimeoutException
        limit = _LONGEST_WAIT_S if end is None else min(_LONGEST_WAIT_S, end - now)
        for node in nodes if nodes is not None else self.get_nodes():
            for timed in (*node._timers, *node._waitables):
                due = timed._seconds_until_due()
                if due is not None and due < limit and self.can_execute(timed):
                    limit = due
        if self._ready_tasks or limit <= 0:
            return
        self._wake_lock.acquire(timeout=limit)

    # -- running ----------------------------------------------------------------------------------------------

    def _made(self, entity: Any, node: Node) -> Task:
        """Return a task that takes what an entity has and runs its callback."""
        work = None if self._is_shutdown else entity._take()

        def finish() -> None:
            entity._executor_event = False
            if entity.callback_group is not None:
                entity.callback_group.ending_execution(entity)
            self.wake()

        return _Handler(self, work or (_nothing, ()), finish, entity, node)

    def _run(self, task: Task) -> None:
        """Run a task one step and see to what comes next."""
        me = threading.get_ident()
        self._active.add(me)
        try:
            task()
        finally:
            self._active.discard(me)
            if self._is_shutdown:
                self._idle.set()
        if task._pending_is_over():
            self._pending_tasks.pop(task, None)
            return
        self._pending_tasks.setdefault(task, (getattr(task, "entity", None), getattr(task, "node", None)))
        awaited = task._awaited
        if awaited is None:
            self._call_task_in_next_spin(task)
        else:
            awaited._add_waker(lambda: self._call_task_in_next_spin(task))


class _Handler(Task):
    """A callback of an entity; plain functions run without the machinery of coroutines."""

    def __init__(
        self,
        executor: Executor,
        work: tuple[Any, ...],
        finish: Callable[[], None],
        entity: Any,
        node: Node,
    ) -> None:
        super().__init__(work[0], work[1], executor=executor)
        self._finish: Callable[[], None] | None = finish
        self._reply: Callable[[Any], None] | None = work[2] if len(work) > 2 else None
        self.entity = entity
        self.node = node

    def __call__(self) -> None:
        """Run one step; give the entity back when it was the last."""
        try:
            super().__call__()
        finally:
            if self._pending_is_over() and self._finish is not None:
                finish, self._finish = self._finish, None
                try:
                    if self._reply is not None and self._exception is None:
                        self._reply(self._result)
                except Exception as error:  # noqa: BLE001  raised where the handler is
                    self.set_exception(error)
                finally:
                    finish()


def _nothing() -> None:
    """Stand for work that is gone when it is looked at."""


class SingleThreadedExecutor(Executor):
    """Runs callbacks in the thread that spins."""

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] = lambda: False
    ) -> None:
        try:
            handler, _, _ = self.wait_for_ready_callbacks(timeout_sec, None, condition)
        except (ShutdownException, TimeoutException, ConditionReachedException):
            return
        self._run(handler)
        if handler.done() and (isinstance(handler, _Handler) or handler._exception is not None):
            handler.result()


class MultiThreadedExecutor(Executor):
    """Runs callbacks in a pool of threads."""

    def __init__(self, num_threads: int | None = None, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        if num_threads is None:
            num_threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 2)
        if num_threads == 1:
            warnings.warn("MultiThreadedExecutor with a single thread: use the SingleThreadedExecutor instead", stacklevel=2)
        self._executor = concurrent.futures.ThreadPoolExecutor(num_threads, thread_name_prefix="rclpy")
        self._failed: collections.deque[Task] = collections.deque()

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] = lambda: False
    ) -> None:
        try:
            handler, _, _ = self.wait_for_ready_callbacks(
                timeout_sec, None, lambda: bool(self._failed) or condition()
            )
        except (ExternalShutdownException, ShutdownException, TimeoutException):
            return
        except ConditionReachedException:
            handler = None  # type: ignore[assignment]
        if handler is not None:
            self._executor.submit(self._work, handler)
        if self._failed:
            self._failed.popleft().result()

    def _work(self, handler: Task) -> None:
        self._run(handler)
        if handler.done() and handler._exception is not None:
            self._failed.append(handler)
            self.wake()

    def shutdown(self, timeout_sec: float | None = None, *, wait_for_threads: bool = True) -> bool:
        """Stop, and wait for the threads."""
        if not super().shutdown(timeout_sec):
            return False
        inside = threading.get_ident() in self._active
        self._executor.shutdown(wait=wait_for_threads and not inside)
        return True


def __getattr__(name: str) -> Any:
    if name == "EventsExecutor":
        from embedded_ros.errors import needs_ros2  # noqa: PLC0415  only for the refusal

        raise needs_ros2("EventsExecutor")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


