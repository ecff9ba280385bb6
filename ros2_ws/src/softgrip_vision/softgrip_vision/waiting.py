# SPDX-License-Identifier: Apache-2.0
"""Waiting for a file that another process writes."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from softgrip_vision.errors import CalibrationError

#: [s] between looks.
PERIOD = 0.05


def file_when_there(path: Path, deadline: float) -> Path:
    """Return the path once a file is there.

    Args:
        path: of the file.
        deadline: [s] to wait at most.

    Raises:
        CalibrationError: when it did not appear.
    """
    clock = threading.Event()
    end = time.monotonic() + deadline
    while not path.is_file():
        if time.monotonic() >= end:
            raise CalibrationError(
                f"{path}: expected a file there within {deadline:g} s, found none; run calibrate_camera"
            )
        clock.wait(PERIOD)
    return path
