# SPDX-License-Identifier: Apache-2.0
"""Clocks: system, steady, and ROS time that a /clock topic may drive."""

from __future__ import annotations

import contextlib
import enum
import threading
import time as _time
import weakref
from typing import TYPE_CHECKING, Self

from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NotInitializedException
from rclpy.time import Time
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.context import Context

__all__ = ["Clock", "ClockChange", "ClockType", "JumpHandle", "JumpThreshold", "ROSClock", "TimeJump"]


class ClockChange(enum.IntEnum):
    """What happened to the source of ROS time."""

    ROS_TIME_NO_CHANGE = 1
    ROS_TIME_ACTIVATED = 2
    ROS_TIME_DEACTIVATED = 3
    SYSTEM_TIME_NO_CHANGE = 4


class JumpThreshold:
    """Which jumps a callback wants to know about."""

    def __init__(
        self, *, min_forward: Duration | None, min_backward: Duration | None, on_clock_change: bool = True
    ) -> None:
        if min_forward is None and min_backward is None and not on_clock_change:
            raise ValueError("At least one jump threshold must be enabled")
        if min_forward is not None and min_forward.nanoseconds <= 0:
            raise ValueError("min_forward must be a positive non-zero duration")
        if min_backward is not None and min_backward.nanoseconds >= 0:
            raise ValueError("min_backward must be a negative non-zero duration")
        self.min_forward = min_forward
        self.min_backward = min_backward
        self.on_clock_change = on_clock_change


class TimeJump:
    """A jump of ROS time."""

    def __init__(self, clock_change: ClockChange, delta: Duration) -> None:
        if not isinstance(clock_change, ClockChange):
            raise TypeError("clock_change must be an instance of rclpy.clock.ClockChange")
        self._clock_change = clock_change
        self._delta = delta

    @property
    def clock_change(self) -> ClockChange:
        """What happened to the source."""
        return self._clock_change

    @property
    def delta(self) -> Duration:
        """How far time jumped."""
        return self._delta


class JumpHandle:
    """Registration of jump callbacks; give it back with :meth:`unregister`."""

    def __init__(
        self,
        *,
        clock: Clock,
        threshold: JumpThreshold,
        pre_callback: Callable[[], None] | None,
        post_callback: Callable[[TimeJump], None] | None,
    ) -> None:
        if pre_callback is None and post_callback is None:
            raise ValueError("One of pre_callback or post_callback must be callable")
        if pre_callback is not None and not callable(pre_callback):
            raise ValueError("pre_callback must be callable if given")
        if post_callback is not None and not callable(post_callback):
            raise ValueError("post_callback must be callable if given")
        if threshold is None:
            raise ValueError("threshold must be given")
        self._clock: Clock | None = clock
        self._threshold = threshold
        self._pre = pre_callback
        self._post = post_callback
        clock._handles.append(self)

    def _wants(self, jump: TimeJump) -> bool:
        if jump.clock_change in {ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED}:
            return self._threshold.on_clock_change
        forward, backward, delta = self._threshold.min_forward, self._threshold.min_backward, jump.delta
        return (forward is not None and delta >= forward) or (backward is not None and delta <= backward)

    def unregister(self) -> None:
        """Stop calling the callbacks."""
        if self._clock is not None and self in self._clock._handles:
            self._clock._handles.remove(self)
        self._clock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unregister()


_READERS = {
    ClockType.ROS_TIME: _time.time_ns,
    ClockType.SYSTEM_TIME: _time.time_ns,
    ClockType.STEADY_TIME: _time.monotonic_ns,
}


class Clock:
    """A source of time."""

    _type: ClockType

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> Clock:  # noqa: PYI034  may be a ROSClock
        """Return a ROSClock when ROS time is asked for."""
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        return object.__new__(ROSClock if clock_type is ClockType.ROS_TIME else cls)

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        if clock_type is ClockType.UNINITIALIZED:
            raise ValueError("expected ROS_TIME, SYSTEM_TIME or STEADY_TIME, found UNINITIALIZED")
        self._type = clock_type
        self._read = _READERS[clock_type]
        self._handles: list[JumpHandle] = []
        self._wakers: weakref.WeakSet[object] = weakref.WeakSet()

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock."""
        return self._type

    def __repr__(self) -> str:
        return f"Clock(clock_type={self._type.name})"

    def _now_ns(self) -> int:
        return self._read()

    def now(self) -> Time:
        """Return the time."""
        return Time(nanoseconds=self._now_ns(), clock_type=self._type)

    def create_jump_callback(
        self,
        threshold: JumpThreshold,
        *,
        pre_callback: Callable[[], None] | None = None,
        post_callback: Callable[[TimeJump], None] | None = None,
    ) -> JumpHandle:
        """Call back when time jumps by more than a threshold; keep the handle."""
        return JumpHandle(clock=self, threshold=threshold, pre_callback=pre_callback, post_callback=post_callback)

    def sleep_until(self, until: Time, context: Context | None = None) -> bool:
        """Sleep until a time of this clock; return False when interrupted by shutdown or a change of time source."""
        context = context or get_default_context()
        if not context.ok():
            raise NotInitializedException
        if until.clock_type != self._type:
            raise ValueError("until's clock type does not match this clock's type")
        wake = threading.Event()
        changed = False

        def on_jump(jump: TimeJump) -> None:
            nonlocal changed
            changed = changed or jump.clock_change in {
                ClockChange.ROS_TIME_ACTIVATED,
                ClockChange.ROS_TIME_DEACTIVATED,
            }
            wake.set()

        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        with self.create_jump_callback(threshold, post_callback=on_jump), context._waking(wake):
            while context.ok() and not changed:
                remaining_ns = until.nanoseconds - self._now_ns()
                if remaining_ns <= 0:
                    return True
                wake.clear()
                if not context.ok() or changed:
                    break
                wake.wait(None if self._is_overridden() else remaining_ns / 1e9)
        return False

    def _is_overridden(self) -> bool:
        return False

    def sleep_for(self, rel_time: Duration, context: Context | None = None) -> bool:
        """Sleep for a duration of this clock; see :meth:`sleep_until`."""
        return self.sleep_until(self.now() + rel_time, context)


class ROSClock(Clock):
    """System time, or what /clock says while it is active."""

    def __new__(cls) -> Self:
        """Make one."""
        return object.__new__(cls)

    def __init__(self, *, clock_type: ClockType = ClockType.ROS_TIME) -> None:
        super().__init__(clock_type=clock_type)
        self._active = False
        self._override_ns = 0
        self._lock = threading.Lock()

    @property
    def ros_time_is_active(self) -> bool:
        """Whether ROS time is driven from outside."""
        return self._active

    def _is_overridden(self) -> bool:
        return self._active

    def _now_ns(self) -> int:
        return self._override_ns if self._active else _time.time_ns()

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        if enabled == self._active:
            return
        before = self._now_ns()
        after = self._override_ns if enabled else _time.time_ns()
        change = ClockChange.ROS_TIME_ACTIVATED if enabled else ClockChange.ROS_TIME_DEACTIVATED
        self._jump(TimeJump(change, Duration(nanoseconds=after - before)), active=enabled, value_ns=self._override_ns)

    def set_ros_time_override(self, time: Time) -> None:
        """Set what ROS time is while it is active."""
        if not isinstance(time, Time):
            raise TypeError("Time must be specified as rclpy.time.Time")
        if self._active:
            delta = Duration(nanoseconds=time.nanoseconds - self._override_ns)
            jump = TimeJump(ClockChange.ROS_TIME_NO_CHANGE, delta)
            self._jump(jump, active=True, value_ns=time.nanoseconds)
        else:
            self._override_ns = time.nanoseconds

    def _jump(self, jump: TimeJump, *, active: bool, value_ns: int) -> None:
        wanting = [handle for handle in list(self._handles) if handle._wants(jump)]
        for handle in wanting:
            if handle._pre is not None:
                handle._pre()
        with self._lock:
            self._active, self._override_ns = active, value_ns
        for handle in wanting:
            if handle._post is not None:
                handle._post(jump)
        for waker in list(self._wakers):
            with contextlib.suppress(AttributeError):
                waker._on_clock_jump(jump)  # type: ignore[attr-defined]
