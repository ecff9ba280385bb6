# SPDX-License-Identifier: Apache-2.0
"""The folder of what a launch reads of a cell file.

Nodes that are started again read it as long as the launch runs, and a launch file has no last action: each launch
removes what earlier ones have left.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path

PREFIX = "softgrip_cell_"
#: [s] since when a folder has to be there before it may be removed: a launch that begins names it nowhere yet.
MIN_AGE_S = 86_400.0
_PROCESSES = Path("/proc")


def make_launch_folder() -> Path:
    """Return a new folder; those that earlier launches have left are removed."""
    _remove_abandoned(Path(tempfile.gettempdir()))
    return Path(tempfile.mkdtemp(prefix=PREFIX))


def _remove_abandoned(place: Path) -> None:
    """Remove this user's folders that are a day old and that no process has on its command line."""
    old = [folder for folder in place.glob(f"{PREFIX}*") if _is_old(folder)]
    lines = _command_lines() if old else []
    for folder in old if lines else []:
        if not any(os.fsencode(folder) in line for line in lines):
            shutil.rmtree(folder, ignore_errors=True)


def _is_old(folder: Path) -> bool:
    try:
        status = folder.lstat()
    except OSError:  # another launch has just removed it
        return False
    return status.st_uid == os.getuid() and time.time() - status.st_mtime > MIN_AGE_S


def _command_lines() -> list[bytes]:
    """Return the command lines of all processes; none where the system does not show them."""
    lines = []
    for entry in _PROCESSES.glob("[0-9]*/cmdline"):
        try:
            lines.append(entry.read_bytes())
        except OSError:  # it has just ended
            continue
    return lines
