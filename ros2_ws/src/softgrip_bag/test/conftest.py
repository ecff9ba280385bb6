# SPDX-License-Identifier: Apache-2.0
"""Small disks, real where the system lets a test mount one, and one as small by what its calls answer."""

from __future__ import annotations

import errno
import os
import subprocess
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

#: [byte]
DISK_BYTES = 8_000_000


@pytest.fixture
def mounted_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of `DISK_BYTES` in memory; where no mount is allowed, the tests with `simulated_disk` are left."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(place)],
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        pytest.skip(f"no mount allowed here: {made.stderr.strip()}; the same tests run on a simulated disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


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
