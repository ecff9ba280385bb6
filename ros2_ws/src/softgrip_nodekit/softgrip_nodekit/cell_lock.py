# SPDX-License-Identifier: Apache-2.0
"""One cell of a name on one machine and domain: a lock that ends with the process, however it ends."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import TextIO

from rclpy.node import Node

from softgrip_nodekit.errors import StartupError


def lock_folder() -> Path:
    """Return the folder of this user's locks in this domain (XDG Base Directory Specification 0.8)."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    base = Path(runtime) if runtime else Path.home() / ".cache"
    return base / "softgrip-locks" / os.environ.get("ROS_DOMAIN_ID", "0")


def claim_name(node: Node) -> TextIO:
    """Make sure that no other process of this user on this machine is the same node; keep what is returned.

    Two cells of one name would command each other's hardware. The lock is on a file that stays; it is free as
    soon as its process is gone, so a killed node can be started again at once.

    Raises:
        StartupError: another process has the name.
    """
    name = node.get_fully_qualified_name()
    folder = lock_folder()
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / f"{name.strip('/').replace('/', '.')}.lock").open("a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.seek(0)
        cell, owner = node.get_namespace().strip("/"), file.read().strip()
        file.close()
        raise StartupError(
            f"expected one cell named {cell!r} in domain {os.environ.get('ROS_DOMAIN_ID', '0')}, found another one "
            f"running ({name}, process {owner}); stop it, or give this cell a name of its own: cell:=..."
        ) from error
    file.truncate(0)
    file.write(str(os.getpid()))
    file.flush()
    return file
