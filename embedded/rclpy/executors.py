# SPDX-License-Identifier: Apache-2.0
"""Executors: wait until an entity of a node has work, run its callback."""

from __future__ import annotations

import collections
import contextlib
import os
import sys
import threading
import time
import traceback
import warnings
from types import CoroutineType
from typing import TYPE_CHECKING, Any, Self

from rclpy.endpoint import Endpoint
from rclpy.task import Future, Task
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.timer import Timer
    from rclpy.waitable import Waitable

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

# Windows does not interrupt a waiting lock for Ctrl-C.
LONGEST_WAIT_S = 0.1 if sys.platform == "win32" else 3600.0
_LOOK_PERIOD_S = 0.1
_LOOK_AT_NEW_NODE_S = 0.001
# Where messages come faster than that, Zenoh's thread and the executor's would hand Python to each other at each one.
_FLOOD = 50
_FLOOD_PERIOD_S = 0.01
_GATHER_S = 0.0002


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


class Continuation(Task[Any]):
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


class Executor:
    """Base of the executors."""

    _others_wait = False  # whether another thread waits for entities that a callback gives back

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = context or get_default_context()
        self._nodes: set[Node] = set()
        self._pending_tasks: dict[Task[Any], tuple[Any, Any]] = {}
        self._ready_tasks: collections.deque[Task[Any]] = collections.deque()
        self._callbacks: Iterator[Task[Any] | Work] | None = None
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

    def _enter_spin(self) -> None:
        with self._spin_lock:
            if self._is_spinning:
                raise RuntimeError("Executor is already spinning")
            self._is_spinning = True

    def _exit_spin(self) -> None:
        self._is_spinning = False

    def create_task(
        self, callback: Callable[..., Any] | Coroutine[Any, Any, Any], *args: Any, **kwargs: Any
    ) -> Task[Any]:
        """Run a function or coroutine in the executor; return the task, which is a future."""
        task: Task[Any] = Task(callback, args, kwargs, executor=self)  # type: ignore[arg-type]
        self._pending_tasks[task] = (None, None)
        self._call_task_in_next_spin(task)
        return task

    def _call_task_in_next_spin(self, task: Task[Any]) -> None:
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

    def spin_until_future_complete(self, future: Future[Any], timeout_sec: float | None = None) -> None:
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
        self, future: Future[Any], timeout_sec: float | TimeoutObject | None = None
    ) -> None:
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

    # -- waiting -------------------------------------------------------------------------------------------------------

    def wake(self) -> None:
        """Make the waiting thread look at everything again."""
        self._poll_requested = True
        self._end_wait()

    def _hint(self, entity: Any, node: Node) -> None:
        """Report that an entity has become ready: the waiting thread need not look for it among all."""
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
    ) -> tuple[Task[Any], Any, Node | None]:
        """Return the next (task, entity, node) that is ready.

        Raises:
            TimeoutException, ShutdownException, ExternalShutdownException, ConditionReachedException: instead.
        """
        item = self._next(timeout_sec, nodes, condition)
        if isinstance(item, Work):
            return Task(self._execute, (item,), executor=self), item.entity, item.node
        return item, *self._pending_tasks.get(item, (None, None))

    def _next(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        nodes: list[Node] | None = None,
        condition: Callable[[], bool] | None = None,
    ) -> Task[Any] | Work:
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

    def _next_ready(self, nodes: list[Node] | None) -> Task[Any] | Work | None:
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
        # ``spin_once`` adds its node again each time: it is looked at before any waiting, but not at every message.
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

    def _look(self, nodes: list[Node] | None) -> Iterator[Task[Any] | Work]:
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
        work = Work(self, entity, node)
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

    def _run(self, task: Task[Any]) -> None:
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

    def _run_in_pool(self, item: Task[Any] | Work) -> None:
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
