# SPDX-License-Identifier: Apache-2.0
"""How a signal ends a node: its callbacks first, the middleware last.

rclpy's own handlers shut the context down at once. A node can then say nothing more: not that torque is off, not that
its tendons are free. Here a signal ends the spin, and the context lives until the node has closed.
"""

from __future__ import annotations

import signal
import socket
import threading
from types import FrameType

from rclpy.executors import Executor

#: What launch, a terminal and a closed terminal send.
_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: [s] between two orders to an executor that has not left its spin: the first may have come before it was in.
_AGAIN_S = 0.05


class Ending:
    """Ends one executor's spin when a signal says so; outside the spin a signal is a KeyboardInterrupt.

    Python runs a signal's handler in the main thread, and only between two of its own instructions, so not while that
    thread waits in the middleware. The signal's number is written to a socket at once, and a thread reads it there.

    A callback that runs is let finish, until a second signal cuts it short.
    """

    def __init__(self) -> None:
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        self._watcher = threading.Thread(target=self._watch, name="ending", daemon=True)
        self._asked = threading.Event()
        self._has_left = threading.Event()
        self._has_come = False
        self._executor: Executor | None = None
        self._former_fd = -1
        self._taken: list[signal.Signals] = []

    @property
    def is_asked(self) -> bool:
        """Whether a signal has come."""
        return self._asked.is_set()

    def take_signals(self) -> None:
        """From now on; outside the main thread Python allows nobody to, and a signal stays what it was."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._watcher.start()
        self._former_fd = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        is_nohup = signal.getsignal(signal.SIGHUP) is not signal.SIG_DFL
        self._taken = [number for number in _ENDS if number != signal.SIGHUP or not is_nohup]
        for number in self._taken:
            signal.signal(number, self._on_signal)

    def spin(self, executor: Executor) -> None:
        """Run callbacks until a signal, the executor or the context ends that; what they raise comes out."""
        self._executor = executor
        if not self.is_asked:
            executor.spin()

    def leave(self) -> None:
        """Let no further signal cut the way to safe short, such as launch's own, five seconds after Ctrl-C."""
        self._has_left.set()
        for number in self._taken:
            signal.signal(number, signal.SIG_IGN)
        if self._taken:
            signal.set_wakeup_fd(self._former_fd)
            self._writer.close()  # nothing more to read
            self._watcher.join()
        self._writer.close()
        self._reader.close()

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        had_come, self._has_come = self._has_come, True
        if self._executor is None or had_come:
            raise KeyboardInterrupt

    def _watch(self) -> None:
        while not {*self._reader.recv(16)} & {*_ENDS}:
            if self._has_left.is_set():
                return
        self._asked.set()
        while not self._has_left.wait(_AGAIN_S):
            if self._executor is not None:
                self._executor.shutdown(timeout_sec=0.0)
