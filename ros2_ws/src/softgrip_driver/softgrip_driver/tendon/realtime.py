# SPDX-License-Identifier: Apache-2.0
"""Real-time priority for one thread: on a busy computer the scheduler alone makes most of a loop's jitter."""

from __future__ import annotations

import os


def claim_processor(priority: int) -> str:
    """Put the calling thread in front of all ordinary ones (SCHED_FIFO), where that is allowed.

    The thread must wait for something in every cycle, as it is not interrupted by ordinary threads.

    Args:
        priority: 1..99 as sched(7); 0 leaves everything as it is.

    Returns:
        How the thread is scheduled, in words, with what to do where it was not allowed.
    """
    if priority == 0:
        return "ordinary"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return (
            f"ordinary: real-time priority {priority} is not allowed; allow it with a line '@dialout - rtprio 50' in "
            "/etc/security/limits.d/, and log in again"
        )
    except (OSError, AttributeError) as error:
        return f"ordinary: this system gives no real-time priority ({error})"
    return f"real-time priority {priority}"
