# SPDX-License-Identifier: Apache-2.0
"""Loggers: lines on stderr in rcutils's form, and /rosout through the node that owns the name."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.clock_type import ClockType
from rclpy.impl.logging_severity import LoggingSeverity

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

_DEFAULT_LEVEL = LoggingSeverity.INFO
_COLOURS = {
    LoggingSeverity.DEBUG: "\033[32m",
    LoggingSeverity.INFO: "\033[0m",
    LoggingSeverity.WARN: "\033[33m",
    LoggingSeverity.ERROR: "\033[31m",
    LoggingSeverity.FATAL: "\033[31m",
}
_FILTERS = {
    "throttle_duration_sec", "throttle_time_source_type", "skip_first", "once", "name",
}  # fmt: skip

#: Lines that a process may say at once, and each second from then on. Whatever makes it say more, the log does not
#: grow without end, and neither does what others must read on /rosout.
MAX_LINES, LINES_PER_S = 1000.0, 50.0
MAX_CHARS = 8000

_levels: dict[str, int] = {}
_sinks: dict[str, Callable[[float, int, str, str, CallerId], None]] = {}


class CallerId(NamedTuple):
    """Where a log call stands."""

    function_name: str
    file_path: str
    line_number: int
    last_index: int


def _caller() -> CallerId:
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename == __file__:
        frame = frame.f_back
    if frame is None:
        return CallerId("", "", 0, 0)
    return CallerId(frame.f_code.co_name, frame.f_code.co_filename, frame.f_lineno, frame.f_lasti)


def set_level(name: str, level: int) -> None:
    """Set the level of a logger name ('' is the root)."""
    _levels[name] = LoggingSeverity(level)


def level_of(name: str) -> LoggingSeverity:
    """Return the level set for exactly this name."""
    return LoggingSeverity(_levels.get(name, LoggingSeverity.UNSET))


def effective_level(name: str) -> LoggingSeverity:
    """Return the level that applies to a name: its own, else its nearest parent's, else INFO."""
    while True:
        if not name:
            return LoggingSeverity(_levels.get(name, _DEFAULT_LEVEL))
        if _levels.get(name):
            return LoggingSeverity(_levels[name])
        name = name.rpartition(".")[0]


def clear() -> None:
    """Forget all levels."""
    _levels.clear()


def add_sink(name: str, sink: Callable[[float, int, str, str, CallerId], None]) -> None:
    """Send what is logged under a name and its children to ``sink(stamp, severity, name, text, caller)`` too."""
    _sinks[name] = sink


def remove_sink(name: str, sink: Callable[[float, int, str, str, CallerId], None]) -> None:
    """Stop sending."""
    if _sinks.get(name) == sink:
        del _sinks[name]


class Budget:
    """Lines that may still be said: a bucket that fills again.

    Args:
        clock: monotonic [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left = MAX_LINES
        self._at = clock()
        self._left_out = 0
        self._lock = threading.Lock()

    def spend(self, *, anyway: bool = False) -> int | None:
        """Return how many lines were left out before this one; None: leave this one out, too, unless it goes anyway."""
        with self._lock:
            now = self._clock()
            self._left = min(MAX_LINES, self._left + (now - self._at) * LINES_PER_S)
            self._at = now
            if self._left < 1.0 and not anyway:
                self._left_out += 1
                return None
            self._left -= 1.0
            left_out, self._left_out = self._left_out, 0
            return left_out


_budget = Budget()


def _write(stamp_ns: int, severity: LoggingSeverity, name: str, text: str, caller: CallerId) -> None:
    layout = os.environ.get("RCUTILS_CONSOLE_OUTPUT_FORMAT", "[{severity}] [{time}] [{name}]: {message}")
    values = {
        "severity": severity.name,
        "time": f"{stamp_ns / 1e9:.9f}" if "{time}" not in layout else f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}",
        "time_as_nanoseconds": str(stamp_ns),
        "name": name,
        "message": text,
        "function_name": caller.function_name,
        "file_name": caller.file_path,
        "line_number": str(caller.line_number),
    }
    line = layout
    for key, value in values.items():
        line = line.replace("{" + key + "}", value)
    stream = sys.stdout if os.environ.get("RCUTILS_LOGGING_USE_STDOUT") == "1" else sys.stderr
    colour = os.environ.get("RCUTILS_COLORIZED_OUTPUT")
    if colour == "1" or (colour != "0" and stream is not None and stream.isatty()):
        line = f"{_COLOURS[severity]}{line}\033[0m"
    if stream is not None:
        stream.write(line + "\n")
        stream.flush()


class RcutilsLogger:
    """Logs under a name."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self._contexts: dict[CallerId, dict[str, Any]] = {}

    def get_child(self, name: str) -> RcutilsLogger:
        """Return the logger ``self.name + '.' + name``."""
        if not name:
            raise ValueError("Child logger name must not be empty.")
        return RcutilsLogger(f"{self.name}.{name}" if self.name else name)

    def set_level(self, level: int | LoggingSeverity) -> None:
        """Set this logger's level."""
        set_level(self.name, LoggingSeverity(level))

    def get_effective_level(self) -> LoggingSeverity:
        """Return the level that applies."""
        return effective_level(self.name)

    def log(self, message: str, severity: int | LoggingSeverity, **kwargs: Any) -> bool:
        """Log a message; return whether it went out.

        Args:
            message: the text.
            severity: how bad.
            kwargs: ``once``, ``skip_first``, ``throttle_duration_sec`` (``throttle_time_source_type``), per call site.
        """
        severity = LoggingSeverity(severity)
        name = kwargs.get("name", self.name) or self.name
        caller = _caller()
        if not self._passes(caller, severity, kwargs) or severity < effective_level(name):
            return False
        left_out = _budget.spend(anyway=severity >= LoggingSeverity.FATAL)
        if left_out is None:
            return False
        stamp_ns = time.time_ns()
        text = str(message)
        if len(text) > MAX_CHARS:
            text = f"{text[:MAX_CHARS]}... ({len(text) - MAX_CHARS} more characters)"
        if left_out:
            text += f" ({left_out} other lines were left out before this one: too many at once)"
        _write(stamp_ns, severity, name, text, caller)
        owner = name
        while owner:
            if owner in _sinks:
                _sinks[owner](stamp_ns, severity, name, text, caller)
                break
            owner = owner.rpartition(".")[0]
        return True

    def _passes(self, caller: CallerId, severity: int, kwargs: dict[str, Any]) -> bool:
        unknown = set(kwargs) - _FILTERS
        if unknown:
            raise TypeError(f"parameter {min(unknown)!r} is not one of the recognized {sorted(_FILTERS)}")
        if "throttle_time_source_type" in kwargs and "throttle_duration_sec" not in kwargs:
            raise TypeError("required parameter 'throttle_duration_sec' not specified for the throttle filter")
        known = self._contexts.get(caller)
        now = dict(kwargs, severity=severity)
        if known is None:
            known = self._contexts[caller] = {"settings": now, "last": 0}
        elif known["settings"] != now:
            before = known["settings"]
            changed = next(
                (key for key in ("severity", "name") if before.get(key) != now.get(key)), "filter parameters"
            )
            raise ValueError(f"Logger {changed} cannot be changed between calls.")
        if kwargs.get("throttle_duration_sec") and not _throttle(
            known, kwargs["throttle_duration_sec"], kwargs.get("throttle_time_source_type")
        ):
            return False
        if kwargs.get("skip_first") and not known.get("skipped"):
            known["skipped"] = True
            return False
        if kwargs.get("once"):
            if known.get("logged"):
                return False
            known["logged"] = True
        return True

    def debug(self, message: str, **kwargs: Any) -> bool:
        """Log at DEBUG."""
        return self.log(message, LoggingSeverity.DEBUG, **kwargs)

    def info(self, message: str, **kwargs: Any) -> bool:
        """Log at INFO."""
        return self.log(message, LoggingSeverity.INFO, **kwargs)

    def warning(self, message: str, **kwargs: Any) -> bool:
        """Log at WARN."""
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    warn = warning

    def error(self, message: str, **kwargs: Any) -> bool:
        """Log at ERROR."""
        return self.log(message, LoggingSeverity.ERROR, **kwargs)

    def fatal(self, message: str, **kwargs: Any) -> bool:
        """Log at FATAL."""
        return self.log(message, LoggingSeverity.FATAL, **kwargs)


def _throttle(known: dict[str, Any], period_s: float, source: Any) -> bool:
    if not isinstance(period_s, int | float):
        raise TypeError(f"throttle_duration_sec: expected seconds, found {period_s!r}")
    if source is None:
        now_ns = time.time_ns()
    elif hasattr(source, "now"):
        now_ns = source.now().nanoseconds
    elif isinstance(source, str) and source in ClockType.__members__:
        now_ns = time.monotonic_ns() if source == "STEADY_TIME" else time.time_ns()
    else:
        raise ValueError(f"Received throttle_time_source_type of {source!r} is not a valid clock or clock type")
    if 0 <= now_ns - known["last"] < period_s * 1e9:
        return False
    known["last"] = now_ns
    return True
