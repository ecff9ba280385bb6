# SPDX-License-Identifier: Apache-2.0
"""What a bag says about the machine and the software that made it."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

#: [s] a hanging file system must not keep a recording from starting.
_GIT_LIMIT = 5.0


def machine() -> dict[str, str]:
    """Return what identifies the machine, its Python and its middleware."""
    try:
        writer = version("mcap")
    except PackageNotFoundError:
        writer = "unknown"
    return {
        "system": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "processors": str(os.cpu_count() or 0),
        "middleware": os.environ.get("RMW_IMPLEMENTATION", ""),
        "mcap": writer,
    }


def arithmetic(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Return what decides how a machine rounds: the kind of processor and a digest of what it can do."""
    try:
        lines = dict(line.split(":", 1) for line in cpuinfo.read_text().splitlines() if ":" in line)
    except OSError:
        return platform.machine()
    fields = {name.strip(): value.strip() for name, value in lines.items()}
    abilities = " ".join(sorted(fields.get("flags", fields.get("Features", "")).split()))
    return f"{platform.machine()} {hashlib.sha256(abilities.encode()).hexdigest()[:16]}"


def rounding_tolerance(recorded: str) -> float:
    """Return how far results may be off those recorded where `arithmetic` was ``recorded``: 0 on the like of it."""
    return 0.0 if recorded.strip() == arithmetic() else 1e-6


def software(folder: Path = Path(__file__).parent) -> dict[str, str]:
    """Return the git version of the checkout that runs, empty where it is none."""
    return {
        "git": _git(folder, "rev-parse", "HEAD"),
        "git_changed_files": _git(folder, "status", "--porcelain", "-uno"),
    }


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=_GIT_LIMIT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
