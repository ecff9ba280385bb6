# SPDX-License-Identifier: Apache-2.0
"""Timers and rates."""

from __future__ import annotations

import inspect
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockChange, TimeJump
from rclpy.destroyable import Destroyable
from rclpy.exceptions import ROSInterruptException
from rclpy.time import Time
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.context import Context


@dataclass(frozen=True)
class TimerInfo:
    """When a timer should have been called and when it was."""

    expected_call_time: Time
    actual_call_time: Time

    @property
    def clock_type(self) -> Any:
        """The kind of clock."""
        return self.expected_call_time.clock_type


class Timer(Destroyable):
    """Made by ``Node.create_timer``; its period is in nanoseconds of its clock."""

    _is_entity = True  # see Endpoint

    def __init__(
        self,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup | None,
        timer_period_ns: int,
        clock: Clock,
        *,
        context: Context | None = None,
        autostart: bool = True,
    ) -> None:
        if timer_period_ns < 0:
            raise ValueError(f"expected a period of 0 ns or more, found {timer_period_ns}")
        self._context = context or get_default_context()
        self.callback = callback
        self._with_info = callback is not None and _takes_info(callback)
        self.callback_group = callback_group
        self._clock = clock
        self._period_ns = timer_period_ns
        self._executor_event = False
        self._canceled = not autostart
        self._destroyed = False
        self._wake: Callable[[], None] = lambda: None
        self._due: Callable[[], None] = lambda: None
        now = clock._now_ns()
        self._last_ns = now
        self._next_ns = now + timer_period_ns
        clock._wakers.add(self)

    @property
    def clock(self) -> Clock:
        """The clock it goes by."""
        return self._clock

    @property
    def timer_period_ns(self) -> int:
        """The period in nanoseconds."""
        self._alive()
        return self._period_ns

    @timer_period_ns.setter
    def timer_period_ns(self, value: int) -> None:
        self._alive()
        self._period_ns = int(value)
        self._wake()

    def is_ready(self) -> bool:
        """Whether it is due."""
        self._alive()
        return self._is_ready()

    def _is_ready(self) -> bool:
        return not self._canceled and self._clock._now_ns() >= self._next_ns

    def _seconds_until_due(self) -> float | None:
        """Return real seconds to wait; None when it is canceled or its clock is driven from outside."""
        if self._canceled or self._clock._is_overridden():
            return None
        return (self._next_ns - self._clock._now_ns()) / 1e9

    def _take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        if not self._is_ready():
            return None
        kind = self._clock.clock_type
        info = TimerInfo(Time(nanoseconds=self._next_ns, clock_type=kind), self._clock.now())
        self._advance(info.actual_call_time.nanoseconds)
        if self.callback is None:
            return None
        return self.callback, ((info,) if self._with_info else ())

    def _advance(self, now_ns: int) -> None:
        """Step to the next call; calls that were missed are left out, the phase is kept."""
        self._last_ns = now_ns
        self._next_ns += self._period_ns
        if self._next_ns < now_ns:
            if self._period_ns == 0:
                self._next_ns = now_ns
            else:
                missed = (now_ns - self._next_ns) // self._period_ns + 1
                self._next_ns += missed * self._period_ns

    def _on_clock_jump(self, jump: TimeJump) -> None:
        now = self._clock._now_ns()
        changed = jump.clock_change in {ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED}
        if changed or now < self._last_ns:
            self._last_ns = now
            self._next_ns = now + self._period_ns
        if changed:
            self._wake()
        elif self._is_ready():
            self._due()

    def is_canceled(self) -> bool:
        """Whether it was canceled."""
        self._alive()
        return self._canceled

    def cancel(self) -> None:
        """Stop calling."""
        self._alive()
        self._canceled = True

    def reset(self) -> None:
        """Start again: the next call is one period from now."""
        self._alive()
        self._last_ns = self._clock._now_ns()
        self._next_ns = self._last_ns + self._period_ns
        self._canceled = False
        self._wake()

    def time_until_next_call(self) -> int | None:
        """Return nanoseconds until the next call; None when canceled."""
        self._alive()
        return None if self._canceled else self._next_ns - self._clock._now_ns()

    def destroy(self) -> None:
        """Forget it."""
        super().destroy()
        self._canceled = True


def _takes_info(callback: Callable[..., Any]) -> bool:
    try:
        parameters = inspect.signature(callback).parameters.values()
    except (TypeError, ValueError):
        return False
    required = [
        item
        for item in parameters
        if item.default is item.empty and item.kind not in {item.VAR_KEYWORD, item.VAR_POSITIONAL}
    ]
    return len(required) == 1


class Rate:
    """Sleeps in step with a timer; another thread must spin the node."""

    def __init__(self, timer: Timer, *, context: Context) -> None:
        self._timer = timer
        self._context = context
        self._condition = threading.Condition()
        self._ticks = 0
        self._sleepers = 0
        self._shutdown = False
        self._destroyed = False
        timer.callback = self._tick
        timer._with_info = False
        context.on_shutdown(self._on_shutdown)

    def _tick(self) -> None:
        with self._condition:
            self._ticks += 1
            self._condition.notify_all()

    def _on_shutdown(self) -> None:
        self._shutdown = True
        if self._condition.acquire(blocking=False):
            try:
                self._condition.notify_all()
            finally:
                self._condition.release()
        self.destroy()

    def destroy(self) -> None:
        """Wake whoever sleeps and end the timer."""
        self._destroyed = True
        self._timer.destroy()
        with self._condition:
            self._condition.notify_all()

    def sleep(self) -> None:
        """Sleep until the next tick.

        Raises:
            ROSInterruptException: shut down meanwhile.
        """
        if self._shutdown or not self._context.ok():
            raise ROSInterruptException
        if self._destroyed:
            raise RuntimeError("Rate cannot sleep because it has been destroyed")
        if self._timer.is_ready():
            self._timer.reset()
        with self._condition:
            seen = self._ticks
            self._condition.wait_for(lambda: self._ticks > seen or self._shutdown or self._destroyed)
        if self._shutdown:
            raise ROSInterruptException
        if self._destroyed:
            raise RuntimeError("Rate cannot sleep because it has been destroyed")
