# SPDX-License-Identifier: Apache-2.0
"""Futures and tasks of the executors."""

from __future__ import annotations

import inspect
import sys
import threading
import warnings
import weakref
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from rclpy.executors import Executor

T = TypeVar("T")


class Future(Generic[T]):
    """The outcome of work that is not finished yet. Await it inside a callback, or add done callbacks."""

    def __init__(self, *, executor: Executor | None = None) -> None:
        self._done = False
        self._cancelled = False
        self._result: T | None = None
        self._exception: BaseException | None = None
        self._exception_fetched = False
        self._callbacks: list[Callable[[Future[T]], Any]] = []
        self._wakers: list[Callable[[], object]] = []
        self._lock = threading.Lock()
        self._executor: weakref.ref[Executor] | None = None
        self._set_executor(executor)

    def __del__(self) -> None:
        if self._exception is not None and not self._exception_fetched:
            print(f"The following exception was never retrieved: {self._exception}", file=sys.stderr)  # noqa: T201

    def __await__(self) -> Generator[Future[T], None, T]:
        while not self._pending_is_over():
            yield self
        return self.result()

    def _pending_is_over(self) -> bool:
        return self._done or self._cancelled

    def cancel(self) -> None:
        """Give the work up, unless it is done."""
        with self._lock:
            if not self._done:
                self._cancelled = True
        self._schedule_or_invoke_done_callbacks()

    def cancelled(self) -> bool:
        """Whether it was given up."""
        return self._cancelled

    def done(self) -> bool:
        """Whether there is a result or an exception."""
        return self._done

    def result(self) -> T:
        """Return the result, None when there is none; raise the exception if there is one."""
        if self._exception is not None:
            self._exception_fetched = True
            raise self._exception
        return self._result  # type: ignore[return-value]  # as rclpy: None, too, before the end

    def exception(self) -> BaseException | None:
        """Return the exception, if any."""
        self._exception_fetched = True
        return self._exception

    def set_result(self, result: T) -> None:
        """Finish with a result."""
        with self._lock:
            self._result = result
            self._done = True
            self._cancelled = False
        self._schedule_or_invoke_done_callbacks()

    def set_exception(self, exception: BaseException) -> None:
        """Finish with an exception."""
        with self._lock:
            self._exception = exception
            self._exception_fetched = False
            self._done = True
            self._cancelled = False
        self._schedule_or_invoke_done_callbacks()

    def _schedule_or_invoke_done_callbacks(self) -> None:
        with self._lock:
            executor = self._executor() if self._executor is not None else None
            callbacks, self._callbacks = self._callbacks, []
            wakers, self._wakers = self._wakers, []
        for wake in wakers:
            wake()
        for callback in callbacks:
            if executor is not None:
                executor.create_task(callback, self)
            else:
                self._invoke(callback)

    def _invoke(self, callback: Callable[[Future[T]], Any]) -> None:
        try:
            callback(self)
        except Exception as error:  # noqa: BLE001  a done callback of someone else must not stop the others
            warnings.warn(f"Unhandled exception in done callback: {error}", RuntimeWarning, stacklevel=3)

    def _set_executor(self, executor: Executor | None) -> None:
        self._executor = None if executor is None else weakref.ref(executor)

    def add_done_callback(self, callback: Callable[[Future[T]], Any]) -> None:
        """Call back with this future when it is over (at once, or through the executor, when it is already)."""
        with self._lock:
            over = self._pending_is_over()
            executor = self._executor() if self._executor is not None else None
            if not over:
                self._callbacks.append(callback)
        if over:
            if executor is not None:
                executor.create_task(callback, self)
            else:
                self._invoke(callback)

    def _add_waker(self, wake: Callable[[], object]) -> None:
        """Call ``wake`` at once, on the thread that ends this future; a task that awaits it goes on then."""
        with self._lock:
            over = self._pending_is_over()
            if not over:
                self._wakers.append(wake)
        if over:
            wake()


class Task(Future[T]):
    """A function or coroutine that an executor runs; call it to go one step on."""

    def __init__(
        self,
        handler: Callable[..., Any],
        args: Any = None,
        kwargs: Any = None,
        executor: Executor | None = None,
    ) -> None:
        super().__init__(executor=executor)
        self._args = args or []
        self._kwargs = kwargs or {}
        if inspect.iscoroutinefunction(handler):
            self._handler: Any = handler(*self._args, **self._kwargs)
            self._args, self._kwargs = [], {}
        else:
            self._handler = handler
        self._executing = False
        self._task_lock = threading.Lock()
        self._awaited: Future[Any] | None = None

    def __call__(self) -> None:
        """Run the function, or the coroutine up to its next await."""
        if self._pending_is_over() or self._executing or not self._task_lock.acquire(blocking=False):
            return
        try:
            if self._pending_is_over():
                return
            self._executing = True
            self._awaited = None
            if inspect.iscoroutine(self._handler):
                self._step()
            else:
                self._run()
        finally:
            self._executing = False
            self._task_lock.release()

    def _step(self) -> None:
        try:
            awaited = self._handler.send(None)
        except StopIteration as stop:
            self.set_result(stop.value)
            self._drop()
        except Exception as error:  # noqa: BLE001  handed to whoever asks for the result
            self.set_exception(error)
            self._drop()
        else:
            self._awaited = awaited if isinstance(awaited, Future) else None

    def _run(self) -> None:
        try:
            self.set_result(self._handler(*self._args, **self._kwargs))
        except Exception as error:  # noqa: BLE001  handed to whoever asks for the result
            self.set_exception(error)
        self._drop()

    def _drop(self) -> None:
        self._handler = None
        self._args, self._kwargs = [], {}

    def executing(self) -> bool:
        """Whether it runs right now."""
        return self._executing

    def cancel(self) -> None:
        """Give the task up and close its coroutine."""
        if inspect.iscoroutine(self._handler) and not self._executing:
            self._handler.close()
        super().cancel()
