# SPDX-License-Identifier: Apache-2.0
"""A throw-away copy of the sources in which a mutant lives: the checkout is never written to."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mutant import Mutant

#: what turns scikit-build's finder, which finds the Python of packages with a compiled core, to the copy; PYTHONPATH
#: does that for all others
_SITE = """
import sys

def moved(path):
    return path.replace({root!r}, {copy!r}, 1) if path.startswith({root!r} + "/ros2_ws/") else path

for finder in sys.meta_path:
    if type(finder).__name__ == "ScikitBuildRedirectingFinder":
        finder.known_source_files = {{name: moved(path) for name, path in finder.known_source_files.items()}}
        finder.submodule_search_locations = {{
            name: [moved(path) for path in paths] for name, paths in finder.submodule_search_locations.items()
        }}
"""
#: pytest that ends when its tests have: a thread that a failed test left behind would keep the process for ever
_PYTEST = "import os, sys, pytest; code = pytest.main(sys.argv[1:]); sys.stdout.flush(); os._exit(code)"
#: pytest: all passed, some failed
PASSED, FAILED = 0, 1


class WorkshopError(Exception):
    """The copy is not what runs, or its tests can not be run at all."""


@dataclass(frozen=True)
class TestRun:
    """How pytest ended.

    Attributes:
        code: its exit code; None when it was stopped after its time limit.
        seconds: that it took.
        failed: node ids of the tests that failed, in the order of the run.
        output: its last lines.
    """

    code: int | None
    seconds: float
    failed: tuple[str, ...]
    output: str


class Workshop:
    """One copy of the sources, with the environment that makes every process import from it.

    Args:
        root: the checkout.
        folder: an empty folder to copy to.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = root
        self._folder = folder
        self._stamp = int(time.time())
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=root, capture_output=True, text=True, check=True,
        )  # fmt: skip
        for name in filter(None, listed.stdout.split("\0")):
            if (root / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, folder / name)
        site = folder / ".mutants" / "sitecustomize.py"
        site.parent.mkdir()
        site.write_text(_SITE.format(root=str(root), copy=str(folder)), encoding="utf-8")
        self._check_redirection()

    @property
    def folder(self) -> Path:
        """The copy's root."""
        return self._folder

    @contextlib.contextmanager
    def mutated(self, mutant: Mutant) -> Iterator[None]:
        """Have an error in the copy for the length of a block."""
        path = self._folder / mutant.file
        source = path.read_text(encoding="utf-8")
        try:
            self._write(path, mutant.apply(source))
            yield
        finally:
            self._write(path, source)

    def run_tests(self, tests: Sequence[str], time_limit_s: float) -> TestRun:
        """Run tests of the copy until the first failure, or until ``time_limit_s`` [s] have passed."""
        command = [
            sys.executable, "-c", _PYTEST, "-q", "-x", "-rf", "--no-header", "--tb=line", "-p", "no:xdist", *tests,
        ]  # fmt: skip
        began = time.monotonic()
        with subprocess.Popen(
            command, cwd=self._folder, env=self._environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        ) as process:  # fmt: skip
            try:
                output, _ = process.communicate(timeout=time_limit_s)
                code: int | None = process.returncode
            except subprocess.TimeoutExpired:
                output, code = "", None
            finally:
                # Nodes that a test started are in the group of the test.
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
        failed = tuple(
            line.partition(" ")[2].partition(" - ")[0]
            for line in output.splitlines()
            if line.startswith(("FAILED ", "ERROR "))
        )
        return TestRun(code, time.monotonic() - began, failed, output[-3000:])

    def _write(self, path: Path, text: str) -> None:
        """Replace a file; a time stamp of its own keeps Python from taking the last mutant's byte code for it."""
        path.write_text(text, encoding="utf-8")
        self._stamp += 2
        os.utime(path, (self._stamp, self._stamp))

    def _packages(self) -> list[Path]:
        """The folders of the workspace's packages that have Python."""
        sources = self._folder / "ros2_ws" / "src"
        return sorted(folder.parents[1] for folder in sources.glob("*/*/__init__.py") if _is_package(folder))

    def _environment(self) -> dict[str, str]:
        sources = self._folder / "ros2_ws" / "src"
        pure = [folder for folder in self._packages() if not (folder / "CMakeLists.txt").exists()]
        paths = [self._folder / ".mutants", self._folder / "embedded", *pure]
        return {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "EMBEDDED_WORKSPACE": str(sources),
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        }

    def _check_redirection(self) -> None:
        """Raise WorkshopError unless the redirected packages are imported from the copy."""
        names = ("rclpy", *(folder.name for folder in self._packages()))
        found = subprocess.run(
            [sys.executable, "-c", f"for n in {names}: print(__import__(n).__file__)"],
            cwd=self._folder, env=self._environment(), capture_output=True, text=True, check=False,
        )  # fmt: skip
        strangers = [line for line in found.stdout.splitlines() if not line.startswith(str(self._folder))]
        if found.returncode != 0 or strangers:
            raise WorkshopError(
                f"expected {', '.join(names)} from {self._folder}, found {strangers or found.stderr}; run make setup"
            )


def _is_package(init: Path) -> bool:
    """Whether an __init__.py is that of a package of the workspace, whose folder has the same name."""
    return init.parent.name == init.parents[1].name
