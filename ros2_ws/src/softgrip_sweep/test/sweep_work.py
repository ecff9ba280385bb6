# SPDX-License-Identifier: Apache-2.0
"""What workers do in these tests; a module of its own, so that worker processes can import it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def square(number):
    return {"square": number**2}


def fail(number):
    raise ValueError(f"no square of {number}")


def die_once(number, folder):
    """Kill the worker the first time, as an out-of-memory killer would."""
    marker = Path(folder) / f"died-{number}"
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return {"square": number**2}
    os.kill(os.getpid(), signal.SIGKILL)
    return None


def square_once_released(number, folder):
    """Say which process does it and where, and wait for a word."""
    Path(folder, f"begun-{number}-{os.getpid()}").write_text(str(Path.cwd()))
    while not Path(folder, "go").exists():
        time.sleep(0.02)
    return {"square": number**2}
