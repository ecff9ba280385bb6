# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM: shut contexts down, then let Python's own handler have its say."""

from __future__ import annotations

import contextlib
import signal
import threading
import weakref
from enum import IntEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import FrameType

    from rclpy.context import Context


class SignalHandlerOptions(IntEnum):
    """Which signals rclpy handles; the numbers are rclpy's."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


_contexts: weakref.WeakSet[Context] = weakref.WeakSet()
_previous: dict[int, Any] = {}
_options = SignalHandlerOptions.NO


def _on_signal(number: int, frame: FrameType | None) -> None:
    for context in list(_contexts):
        context._shutdown_by_signal(signal.Signals(number).name)
    previous = _previous.get(number)
    # SIGTERM's default would end the process before its nodes could stop their hardware.
    if callable(previous):
        previous(number, frame)


def register_context(context: Context) -> None:
    """Shut a context down when a handled signal comes."""
    _contexts.add(context)


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Install the handlers; only the main thread can, elsewhere nothing happens."""
    global _options  # noqa: PLW0603  signals belong to the process
    if threading.current_thread() is not threading.main_thread():
        return
    for option, number in (
        (SignalHandlerOptions.SIGINT, signal.SIGINT),
        (SignalHandlerOptions.SIGTERM, signal.SIGTERM),
    ):
        if options & option and number not in _previous:
            _previous[number] = signal.signal(number, _on_signal)
    _options = SignalHandlerOptions(_options | options)


def get_current_signal_handlers_options() -> SignalHandlerOptions:
    """Return which signals are handled."""
    return _options


def uninstall_signal_handlers() -> None:
    """Give the signals back."""
    global _options  # noqa: PLW0603  signals belong to the process
    if threading.current_thread() is not threading.main_thread():
        return
    for number, previous in list(_previous.items()):
        with contextlib.suppress(TypeError):
            if signal.getsignal(number) is _on_signal:
                signal.signal(number, previous)
        del _previous[number]
    _options = SignalHandlerOptions.NO
