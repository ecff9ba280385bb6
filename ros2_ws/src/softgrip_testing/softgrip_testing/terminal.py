# SPDX-License-Identifier: Apache-2.0
"""A command at a pseudo-terminal, and the person who reads it and presses Enter."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path


class CommandTerminal:
    """A command at a terminal of its own.

    Args:
        line: the command, as it is typed.
        environment: of it.
        folder: that it runs in.

    Attributes:
        text: what it has printed. process: of the command.
    """

    def __init__(self, line: str, environment: dict[str, str], folder: Path) -> None:
        self._handle, end = pty.openpty()
        self.text = ""
        self.process = subprocess.Popen(
            ["bash", "-c", line], stdin=end, stdout=end, stderr=end, env=environment, cwd=folder, start_new_session=True
        )
        os.close(end)

    def read_until(self, texts: Sequence[str], timeout_s: float) -> str:
        """Return which of some texts came first since the last one, "" at the end of the command.

        Raises:
            AssertionError: none came within a time [s].
        """
        deadline, seen = time.monotonic() + timeout_s, ""
        while time.monotonic() < deadline:
            if select.select([self._handle], [], [], 0.1)[0]:
                try:
                    data = os.read(self._handle, 4096).decode(errors="replace")
                except OSError:
                    return ""
                self.text, seen = self.text + data, seen + data
            for text in texts:
                if text in seen:
                    return text
            if self.process.poll() is not None and not select.select([self._handle], [], [], 0.2)[0]:
                return ""
        raise AssertionError(f"expected one of {texts} within {timeout_s:g} s, found:\n{self.text[-3000:]}")

    def press_enter(self) -> None:
        """Press Enter."""
        os.write(self._handle, b"\n")

    def end(self, signal_number: int = signal.SIGINT) -> None:
        """Press Ctrl-C, or send another signal."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal_number)

    def wait(self, timeout_s: float) -> int:
        """Read on to the end of the command, for a time [s] at most; return its exit code."""
        self.read_until((), timeout_s)
        return self.process.wait(timeout_s)
