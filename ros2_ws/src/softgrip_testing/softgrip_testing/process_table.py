# SPDX-License-Identifier: Apache-2.0
"""The processes of a launch, and what each takes; Linux only (proc(5))."""

from __future__ import annotations

import os
from pathlib import Path

_PROC = Path("/proc")


def session_processes(session: int) -> dict[int, str]:
    """Return process id -> command line of what runs in a session: a launch, by its process id, and what it started."""
    found = {}
    for entry in _PROC.iterdir():
        if entry.name.isdigit():
            try:
                state, _, _, leader = _stat(int(entry.name))[:4]
                command = (entry / "cmdline").read_text()
            except OSError:
                continue
            if int(leader) == session and state != "Z":
                found[int(entry.name)] = command
    return found


def node_processes(session: int) -> dict[str, int]:
    """Return node -> process id of the nodes that run in a session."""
    found = {}
    for process, command in session_processes(session).items():
        name = command.partition("__node:=")[2].partition("\0")[0]
        if name and "keep_running" not in command:
            found[name] = process
    return found


def processor_s(process: int) -> float:
    """Return the processor time of a process [s].

    Raises:
        OSError: it is gone.
    """
    fields = _stat(process)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_bytes(process: int) -> int:
    """Return the resident memory of a process [byte]; 0 when it is gone."""
    try:
        return int((_PROC / str(process) / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _stat(process: int) -> list[str]:
    """Return the fields from the state on: what comes before may hold spaces."""
    return (_PROC / str(process) / "stat").read_text().rpartition(")")[2].split()
