# SPDX-License-Identifier: Apache-2.0
"""The folder of the wires: of one user alone, because whoever can write there can stand in for a servo or a camera."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from softgrip_emulator.errors import EmulatorError

_PRIVATE = 0o700
_WRITABLE_BY_OTHERS = 0o022


def default_wire_folder() -> Path:
    """Return softgrip below the user's run-time folder (XDG Base Directory Specification 0.8), else below ~/.cache."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return (Path(runtime) if runtime else Path.home() / ".cache") / "softgrip"


def open_wire_folder(folder: Path) -> None:
    """Make the folder for this user alone; one that is there already must be this user's.

    Raises:
        EmulatorError: it belongs to somebody else, or others may write to it.
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=_PRIVATE, exist_ok=True)
    found = folder.stat()
    if found.st_uid != os.getuid() or found.st_mode & _WRITABLE_BY_OTHERS:
        raise EmulatorError(
            f"wire folder {folder}: expected one that only user {os.getuid()} can write to, found user {found.st_uid}, "
            f"mode {stat.S_IMODE(found.st_mode):04o}; name another one with wire_dir, or delete it"
        )
