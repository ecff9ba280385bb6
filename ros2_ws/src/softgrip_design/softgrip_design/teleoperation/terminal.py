# SPDX-License-Identifier: Apache-2.0
"""Keys of the terminal while they are pressed, in a thread of its own; the terminal is put right again at the end."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self

_WAIT_S: Final = 0.05


class TerminalKeys:
    """Calls back for every key that comes in, as a context.

    Args:
        pressed: called with the character, in the thread of the keys.
    """

    def __init__(self, pressed: Callable[[str], None]) -> None:
        self._pressed = pressed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)
        self._before: list[Any] | None = None

    @property
    def is_terminal(self) -> bool:
        """Whether there are keys at all."""
        return sys.stdin.isatty()

    def __enter__(self) -> Self:
        if self.is_terminal:
            self._before = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._before is not None:
            self._thread.join(1.0)
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._before)

    def _read(self) -> None:
        descriptor = sys.stdin.fileno()
        while not self._ended.is_set():
            ready, _, _ = select.select([descriptor], [], [], _WAIT_S)
            if not ready:
                continue
            keys = os.read(descriptor, 64)
            if not keys:  # the terminal is gone
                return
            for key in keys.decode(errors="ignore"):
                self._pressed(key)
