# SPDX-License-Identifier: Apache-2.0
"""Runs a node and starts it again when it ends.

    python3 -IS keep_running.py [--end-launch-on-refusal] COMMAND...

It stands in a launch file as a launch-prefix. What `respawn` of a launch file cannot tell apart, this does: a node that
refuses to start (a wrong parameter, a missing device) ends the cell with its reason; a node that has worked comes back
for ever, however it ended, after a pause that grows while it does not last. A refusal is passed on as an exit code,
which ``on_exit: shutdown`` waits for. Without that attribute, ``--end-launch-on-refusal`` ends the launch instead, and
the death of this process alone ends nothing.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from types import FrameType

OPTION = "--end-launch-on-refusal"
#: What softgrip's nodes end with when they cannot start.
CANNOT_START = 2
#: [s] However busy the machine is, a node that cannot start has said so by then.
START_LIMIT = 120.0
#: [s] A node that ends by itself sooner than this, at the first start, has not begun its work either.
STARTED_AFTER = 10.0
#: [s] before a node is started again: the first pause, and the longest. Each is twice the one before.
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 30.0
#: [s] A node that worked for so long has its first pause again.
LASTED = 60.0
_PR_SET_PDEATHSIG = 1


class Restarts:
    """Decides what follows the end of a node."""

    def __init__(self) -> None:
        self._has_worked = False
        self._pause = FIRST_PAUSE

    def pause_after(self, code: int, lasted: float) -> float | None:
        """Return how long [s] to wait before the next start; None where the node refused the first one.

        Args:
            code: as subprocess gives it: negative = the signal that killed the node.
            lasted: [s] how long the node ran.
        """
        limit = START_LIMIT if code == CANNOT_START else STARTED_AFTER
        if not self._has_worked and code >= 0 and lasted < limit:
            return None
        self._has_worked = True
        if lasted >= LASTED:
            self._pause = FIRST_PAUSE
        pause, self._pause = self._pause, min(2.0 * self._pause, LONGEST_PAUSE)
        return pause


class Keeper:
    """Keeps one command running until it refuses to start or a signal ends both."""

    def __init__(self, command: list[str], *, end_launch: bool = False) -> None:
        self._command = command
        self._end_launch = end_launch
        self._child: subprocess.Popen[bytes] | None = None
        self._ended_by: int | None = None  # signal
        self._stopping = threading.Event()
        self._restarts = Restarts()

    def run(self) -> int:
        """Return the exit code of the command's last run."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._pass_on)
        while True:
            started = time.monotonic()
            code = self._run_once()
            pause = None if self._stopping.is_set() else self._restarts.pause_after(code, time.monotonic() - started)
            if pause is None:
                if self._end_launch and not self._stopping.is_set() and os.getppid() != 1:
                    os.kill(os.getppid(), signal.SIGINT)
                return code if code >= 0 else 128 - code
            how = f"ended with exit code {code}" if code >= 0 else f"was killed by {signal.Signals(-code).name}"
            self._say(f"{how}; starting it again" + (f" in {pause:.0f} s" if pause > FIRST_PAUSE else ""))
            if self._stopping.wait(pause):
                return 0

    def _run_once(self) -> int:
        # A group of its own: a signal to ours, such as Ctrl-C in a terminal, reaches it once, through us.
        self._child = subprocess.Popen(self._command, process_group=0, preexec_fn=_end_with_parent)  # noqa: PLW1509
        if self._ended_by is not None:  # the signal came before there was a child to pass it to
            self._child.send_signal(self._ended_by)
        return self._child.wait()

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        del frame
        self._ended_by = number
        self._stopping.set()
        if self._child is not None:
            self._child.send_signal(number)

    def _say(self, text: str) -> None:
        print(f"[keep_running] the node {text}", file=sys.stderr, flush=True)  # noqa: T201


def _end_with_parent() -> None:
    """On Linux, have the kernel end this process when its parent is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


if __name__ == "__main__":
    _end_with_parent()
    words = sys.argv[1:]
    ends_launch = words[:1] == [OPTION]
    sys.exit(Keeper(words[ends_launch:], end_launch=ends_launch).run())
