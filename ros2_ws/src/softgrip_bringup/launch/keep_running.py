# SPDX-License-Identifier: Apache-2.0
"""Runs a node and starts it again when it was killed: ``python3 -IS keep_running.py COMMAND...`` as a launch-prefix.

What `respawn` of a launch file cannot tell apart, this does: a node that refuses to start (a wrong parameter, a missing
device) passes its exit code on, so that ``on_exit: shutdown`` ends the cell with the reason; a node that is killed or
crashes in the middle of its work is started again, and the other nodes go on.
"""

from __future__ import annotations

import collections
import ctypes
import signal
import subprocess
import sys
import time
from types import FrameType

#: What softgrip's nodes end with when they cannot start, however long a busy machine takes to get that far.
CANNOT_START = 2
#: [s] A node that ends by itself sooner than this has not begun its work: it refused to start.
STARTED_AFTER = 10.0
#: [s] before a node is started again
PAUSE = 1.0
#: As many restarts within this time [s] are a node that cannot run.
MOST_RESTARTS, WITHIN = 5, 60.0
_PR_SET_PDEATHSIG = 1


class Keeper:
    """Keeps one command running until it ends by itself or a signal ends both."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._child: subprocess.Popen[bytes] | None = None
        self._ended_by: int | None = None  # signal
        self._restarts: collections.deque[float] = collections.deque(maxlen=MOST_RESTARTS)

    def run(self) -> int:
        """Return the exit code of the command's last run."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._pass_on)
        while True:
            started = time.monotonic()
            code = self._run_once()
            early = code > 0 and time.monotonic() - started < STARTED_AFTER
            refused = code in {0, CANNOT_START} or early
            if self._ended_by is not None or refused:
                return code if code >= 0 else 128 - code
            how = f"ended with exit code {code}" if code >= 0 else f"was killed by {signal.Signals(-code).name}"
            if self._too_often():
                self._say(f"{how}, for the {MOST_RESTARTS}th time within {WITHIN:.0f} s; giving up")
                return 1
            self._say(f"{how}; starting it again")
            time.sleep(PAUSE)
            if self._ended_by is not None:
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
        if self._child is not None:
            self._child.send_signal(number)

    def _too_often(self) -> bool:
        now = time.monotonic()
        self._restarts.append(now)
        return len(self._restarts) == MOST_RESTARTS and now - self._restarts[0] < WITHIN

    def _say(self, text: str) -> None:
        print(f"[keep_running] the node {text}", file=sys.stderr, flush=True)  # noqa: T201


def _end_with_parent() -> None:
    """On Linux, have the kernel end this process when its parent is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


if __name__ == "__main__":
    _end_with_parent()
    sys.exit(Keeper(sys.argv[1:]).run())
