# SPDX-License-Identifier: Apache-2.0
"""Settings for every test of the suite."""

import os
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# A busy machine is no failure: no test of this suite is about time.
settings.register_profile("softgrip", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("softgrip")

# Nodes that tests make, and processes that they start, have a ROS graph of their own: a cell may be at work here.
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 50 + 1)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

#: [byte] of a disk that tests fill.
DISK_BYTES = 8_000_000
_NUMBER = re.compile(r"\d+(?:\.(\d+))?")


@pytest.fixture(scope="session", autouse=True)
def _temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Put what tests, and processes that they start and kill, leave in the temporary folder into pytest's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("tmp")))
        patch.setattr(tempfile, "tempdir", None)
        yield


@pytest.fixture
def differences() -> Callable[[str, str], list[str]]:
    """Return what compares a written document with what the code gives for it.

    Compilers and processors round differently, so a number may differ by one unit of its last digit; no word may.
    """

    def lines(written: str, given: str) -> list[str]:
        left, right = written.splitlines(), given.splitlines()
        found = [] if len(left) == len(right) else [f"expected {len(right)} lines, found {len(left)}"]
        found += [f"- {a}\n+ {b}" for a, b in zip(left, right, strict=False) if not _same(a, b)]
        return found

    return lines


def _same(written: str, given: str) -> bool:
    if written == given:
        return True
    words = [" ".join(_NUMBER.sub("#", line).split()) for line in (written, given)]
    pairs = zip(_NUMBER.finditer(written), _NUMBER.finditer(given), strict=False)
    return words[0] == words[1] and all(_close(a, b) for a, b in pairs)


def _close(written: re.Match[str], given: re.Match[str]) -> bool:
    step = 10.0 ** -len(written[1] or "")
    return abs(float(written[0]) - float(given[0])) < 1.5 * step


class VolatileDisk:
    """A folder of which a power cut leaves only what was put on the disk: the model of fsync(2).

    A file keeps the content of its last fsync or fdatasync, nothing when it had none. A folder keeps the names of its
    last fsync; those after it may or may not have reached the disk. What was there at the beginning is on the disk.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self._held: list[int] = []  # an inode that is held is not used again for another file
        self._content: dict[int, bytes] = {}
        self._names = self._present()
        for path in self._names:
            self._keep(path)
        #: What could be found after a power cut before and after each call that matters, in order: file -> content.
        self.moments: list[tuple[dict[str, bytes], ...]] = []
        for name in ("fsync", "fdatasync", "replace", "rename", "link", "unlink"):
            monkeypatch.setattr(os, name, self._watched(name, getattr(os, name)))

    def after_power_cut(self) -> tuple[dict[str, bytes], dict[str, bytes]]:
        """Return what could be found: without, and with the names that were not put on the disk."""
        present = self._present()
        return self._as_found(self._names), self._as_found(present)

    def close(self) -> None:
        """Let go of the files."""
        for descriptor in self._held:
            os.close(descriptor)

    def _as_found(self, names: dict[Path, int]) -> dict[str, bytes]:
        return {str(path.relative_to(self._folder)): self._content.get(inode, b"") for path, inode in names.items()}

    def _present(self) -> dict[Path, int]:
        return {path: path.stat().st_ino for path in sorted(self._folder.rglob("*")) if path.is_file()}

    def _keep(self, path: Path) -> None:
        self._held.append(os.open(path, os.O_RDONLY))
        self._content[path.stat().st_ino] = path.read_bytes()

    def _watched(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any, **options: Any) -> Any:
            self.moments.append(self.after_power_cut())
            result = call(*arguments, **options)
            if name in {"fsync", "fdatasync"}:
                self._synced(Path(f"/proc/self/fd/{arguments[0]}").readlink())
            self.moments.append(self.after_power_cut())
            return result

        return watched

    def _synced(self, path: Path) -> None:
        if path.is_dir():
            elsewhere = {p: inode for p, inode in self._names.items() if p.parent != path}
            self._names = elsewhere | {p: inode for p, inode in self._present().items() if p.parent == path}
        elif path.is_file() and self._folder in path.parents:
            self._keep(path)


@pytest.fixture
def volatile_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], VolatileDisk]]:
    """Give what begins to watch the test's folder; what is in it then is on the disk."""
    made: list[VolatileDisk] = []

    def begin() -> VolatileDisk:
        made.append(VolatileDisk(tmp_path, monkeypatch))
        return made[-1]

    yield begin
    for disk in made:
        disk.close()


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
