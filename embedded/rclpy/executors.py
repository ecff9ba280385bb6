# SPDX-License-Identifier: Apache-2.0
"""Executors: wait until an entity of a node has work, run its callback."""

from __future__ import annotations

import collections
import contextlib
import os
import threading
import time
import warnings
from types import CoroutineType
from typing import TYPE_CHECKING, Any, Self

from rclpy.executor_waiting import LONGEST_WAIT_S, Waiting
from rclpy.executor_work import (
    ConditionReachedException,
    Continuation,
    ExternalShutdownException,
    ShutdownException,
    TimeoutException,
    TimeoutObject,
    Work,
)
from rclpy.task import Future, Task
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from rclpy.context import Context
    from rclpy.node import Node

__all__ = [
    "ConditionReachedException",
    "Executor",
    "ExternalShutdownException",
    "MultiThreadedExecutor",
    "ShutdownException",
    "SingleThreadedExecutor",
    "TimeoutException",
    "TimeoutObject",
]


class Executor(Waiting):
    """Base of the executors."""

    _others_wait = False  # whether another thread waits for entities that a callback gives back

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = context or get_default_context()
        super().__init__()
        self._nodes_lock = threading.RLock()
        self._is_shutdown = False
        self._is_spinning = False
        self._spin_lock = threading.Lock()
        self._active: set[int] = set()
        self._idle = threading.Event()
        self._context._wakers.add(self)

    @property
    def context(self) -> Context:
        """The context."""
        return self._context

    @property
    def is_spinning(self) -> bool:
        """Whether a thread is spinning it."""
        return self._is_spinning

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
        self._node_came = True
        if self._is_spinning:
            self.wake()
        return True

    def remove_node(self, node: Node) -> None:
        """Let a node go."""
        with self._nodes_lock:
            if node in self._nodes:
                self._nodes.discard(node)
        if self._is_spinning:
            self.wake()

    def get_nodes(self) -> list[Node]:
        """Return the nodes."""
        with self._nodes_lock:
            return [*self._nodes]

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
                self._idle.wait(LONGEST_WAIT_S if end is None else max(0.0, end - time.monotonic()))
        with self._nodes_lock:
            for node in list(self._nodes):
                self.remove_node(node)
        return True

    def __enter__(self) -> Self:
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

    def spin_once_until_future_complete(self, future: Future, timeout_sec: float | TimeoutObject | None = None) -> None:
        """Run one callback unless the future is over."""
        self._enter_spin()
        future._add_waker(self.wake)
        try:
            self._spin_once_impl(timeout_sec, future._pending_is_over)
        finally:
            self._exit_spin()

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] | None = None
    ) -> None:
        raise NotImplementedError

    # -- running ----------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _busy(self) -> Iterator[None]:
        """Mark this thread as running a callback; ``shutdown`` waits for it."""
        me = threading.get_ident()
        self._active.add(me)
        try:
            yield
        finally:
            self._active.discard(me)
            if self._is_shutdown:
                self._idle.set()

    def _execute(self, work: Work) -> None:
        """Run a callback. A plain function is done then; a coroutine goes on as a task."""
        taken = work.taken  # callback, arguments, and for some what to do with the result
        pending = None
        me = threading.get_ident()
        self._active.add(me)
        try:
            result = taken[0](*taken[1])
            if result.__class__ is CoroutineType:
                pending = Continuation(self, result, work, taken[2:])
            elif len(taken) > 2:
                taken[2](result)
        finally:
            self._active.discard(me)
            if self._is_shutdown:
                self._idle.set()
            if pending is None:
                work.finish()
        if pending is not None:
            self._pending_tasks[pending] = (work.entity, work.node)
            self._run(pending)
            if pending.done():
                pending.result()

    def _run(self, task: Task) -> None:
        """Run a task one step and see to what comes next."""
        with self._busy():
            task()
        if task._pending_is_over():
            self._pending_tasks.pop(task, None)
            return
        awaited = task._awaited
        if awaited is None:
            self._call_task_in_next_spin(task)
        else:
            awaited._add_waker(lambda: self._call_task_in_next_spin(task))


class SingleThreadedExecutor(Executor):
    """Runs callbacks in the thread that spins."""

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] | None = None
    ) -> None:
        try:
            item = self._next(timeout_sec, None, condition)
        except (ShutdownException, TimeoutException, ConditionReachedException):
            return
        if isinstance(item, Work):
            self._execute(item)
            return
        self._run(item)
        if item.done() and item._exception is not None:
            item.result()


class MultiThreadedExecutor(Executor):
    """Runs callbacks in a pool of threads."""

    _others_wait = True

    def __init__(self, num_threads: int | None = None, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        if num_threads is None:
            num_threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 2)
        if num_threads == 1:
            warnings.warn(
                "MultiThreadedExecutor with a single thread: use the SingleThreadedExecutor instead", stacklevel=2
            )
        import concurrent.futures  # noqa: PLC0415  costs start-up, and most nodes run single-threaded

        self._executor = concurrent.futures.ThreadPoolExecutor(num_threads, thread_name_prefix="rclpy")
        self._failed: collections.deque[BaseException] = collections.deque()

    def _spin_once_impl(
        self, timeout_sec: float | TimeoutObject | None = None, condition: Callable[[], bool] | None = None
    ) -> None:
        try:
            item = self._next(timeout_sec, None, lambda: bool(self._failed) or (condition is not None and condition()))
        except (ExternalShutdownException, ShutdownException, TimeoutException):
            return
        except ConditionReachedException:
            if self._failed:
                raise self._failed.popleft() from None
            return
        self._executor.submit(self._run_in_pool, item)

    def _run_in_pool(self, item: Task | Work) -> None:
        try:
            if isinstance(item, Work):
                self._execute(item)
            else:
                self._run(item)
                if item.done() and item._exception is not None:
                    item.result()
        except BaseException as error:  # noqa: BLE001  raised again by the thread that spins
            self._failed.append(error)
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
