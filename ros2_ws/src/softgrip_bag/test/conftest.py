# SPDX-License-Identifier: Apache-2.0
"""A small disk, real where the system lets a test mount one, and one as small by what its calls answer."""

from __future__ import annotations

import errno
import os
import types
from pathlib import Path
from typing import Any

import pytest

#: [byte] as `mounted_disk` has.
DISK_BYTES = 8_000_000


@pytest.fixture
def simulated_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder whose system calls answer as a disk of `DISK_BYTES` would: ENOSPC, and what statvfs says is free."""
    place = tmp_path / "disk"
    place.mkdir()
    real = {name: getattr(os, name) for name in ("write", "statvfs")}

    def used() -> int:
        return sum(path.stat().st_size for path in place.rglob("*") if path.is_file())

    def write(descriptor: int, data: Any) -> int:
        link = Path(f"/proc/self/fd/{descriptor}")
        if link.is_symlink() and place in link.readlink().parents:
            data = data[: max(DISK_BYTES - used(), 0)]
            if not data:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return int(real["write"](descriptor, data))

    def statvfs(path: Any) -> Any:
        if place in (Path(path), *Path(path).parents):
            return types.SimpleNamespace(f_bavail=max(DISK_BYTES - used(), 0), f_frsize=1)
        return real["statvfs"](path)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(os, "statvfs", statvfs)
    return place


@pytest.fixture(params=["mounted", "simulated"])
def small_disk(request: pytest.FixtureRequest) -> Path:
    """A disk of `DISK_BYTES`, both ways."""
    return Path(request.getfixturevalue(f"{request.param}_disk"))
