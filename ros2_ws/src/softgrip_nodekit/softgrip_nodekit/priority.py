# SPDX-License-Identifier: Apache-2.0
"""Real-time priority for a node's process: on a busy computer the scheduler alone makes most of its delays."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from contextlib import suppress
from enum import IntEnum
from pathlib import Path

from softgrip_nodekit.parameters import Parameter

#: Name of the parameter by which `run` gives a node's process its priority.
REALTIME_PRIORITY = "realtime_priority"


class Rank(IntEnum):
    """Who comes before whom in a cell, as SCHED_FIFO priorities (sched(7)).

    Only what works for a millisecond at a time has one by itself. The kernel's workers that carry a serial port's bytes
    are ordinary: a tracker in front of them, busy with a frame, holds up the bus. Who wants that is told (`FRAMES`).
    """

    EMULATED_HARDWARE = 25
    """real hardware waits for nobody"""
    DRIVES = 20
    PREDICTION = 18
    FRAMES = 10
    """by choice: camera and tracker, where frames matter more than the bus' last millisecond (see `WhileBrief`)"""
    ORDINARY = 0


def realtime_parameter(rank: Rank) -> Parameter:
    """Return the row of a node's parameter table by which `run` gives its process a priority."""
    return Parameter(
        REALTIME_PRIORITY, int(rank), "of the node's threads where the system allows it; 0 = as any other", "", 0, 99
    )


def own_threads() -> list[int]:
    """Return the threads of this process; the calling one alone where the system does not tell."""
    try:
        return [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    except OSError:
        return [0]


def claim_processor(priority: int, threads: Iterable[int] = (0,)) -> str:
    """Put threads in front of all ordinary ones (SCHED_FIFO), where that is allowed; those they start inherit it.

    A thread so put must wait for something again and again: ordinary ones do not interrupt it.

    Args:
        priority: 1..99 as sched(7); 0 leaves everything as it is.
        threads: of this process; 0 is the calling one.

    Returns:
        How they are scheduled, in words, with what to do where it was not allowed.
    """
    if priority == 0:
        return "ordinary priority"
    try:
        for thread in threads:
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return (
            f"ordinary priority: real-time priority {priority} is not allowed; allow it with a line "
            "'@dialout - rtprio 50' in /etc/security/limits.d/, and log in again"
        )
    except (OSError, AttributeError) as error:
        return f"ordinary priority: this system gives no real-time priority ({error})"
    return f"real-time priority {priority}"


class Breather:
    """Lets ordinary threads onto the processors of a real-time process that messages keep busy.

    A serial port's bytes come by an ordinary thread of the kernel (tty's work queue). Behind a real-time process in a
    flood of messages it stands until that process waits, and with it the bus that the process is real-time for: seen
    were replies 60 to 130 ms late.

    Args:
        after_s: [s] of processor time of the process in one go, after which the calling thread pauses.
        for_s: [s] that it pauses.
    """

    def __init__(self, after_s: float = 0.003, for_s: float = 0.001) -> None:
        self._after, self._for = after_s, for_s
        self._used, self._since = time.process_time(), time.monotonic()

    def take_breath(self) -> bool:
        """Pause where that is due, and return whether it was; for the thread that takes messages, between two."""
        used = time.process_time() - self._used
        if used < self._after:
            return False
        # a process that waited for as long as it worked has left its processor to others already
        is_due = time.monotonic() - self._since < 2.0 * used and os.sched_getscheduler(0) != os.SCHED_OTHER
        if is_due:
            time.sleep(self._for)
        self._used, self._since = time.process_time(), time.monotonic()
        return is_due


class WhileBrief:
    """Keeps a process in front of the ordinary ones only while each turn of its work is brief.

    Args:
        priority: that the process was given, see `claim_processor`; 0 = none to keep.
        longest_s: [s] of processor time. A turn that takes more puts the process back among the ordinary ones.
        turns: as many brief ones in a row bring it back in front.
    """

    def __init__(self, priority: int, longest_s: float = 0.01, turns: int = 50) -> None:
        self._priority, self._longest, self._turns = priority, longest_s, turns
        self._in_front = priority > 0
        self._brief = 0

    def add_turn(self, seconds: float) -> None:
        """Note how much processor time [s] a turn took."""
        if self._priority == 0:
            return
        self._brief = 0 if seconds > self._longest else self._brief + 1
        if self._in_front and self._brief == 0:
            self._in_front = False
            _to_ordinary(own_threads())
        elif not self._in_front and self._brief >= self._turns:
            self._in_front = True
            claim_processor(self._priority, own_threads())


def _to_ordinary(threads: Iterable[int]) -> None:
    for thread in threads:
        with suppress(OSError, AttributeError):  # it has ended, or there never was another priority
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
