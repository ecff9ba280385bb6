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

#: packages whose Python comes from the copy; those with a compiled core stay the checkout's, and have no mutants
_REDIRECTED = ("softgrip_driver", "softgrip_cell", "softgrip_bag", "softgrip_nodekit", "softgrip_demo")
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
            sys.executable, "-m", "pytest", "-q", "-x", "-rf", "--no-header", "--tb=line", "-p", "no:xdist", *tests,
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

    def _environment(self) -> dict[str, str]:
        sources = self._folder / "ros2_ws" / "src"
        paths = [self._folder / "embedded", *(sources / name for name in _REDIRECTED)]
        return {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "EMBEDDED_WORKSPACE": str(sources),
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        }

    def _check_redirection(self) -> None:
        """Raise WorkshopError unless the redirected packages are imported from the copy."""
        names = ("rclpy", *_REDIRECTED)
        found = subprocess.run(
            [sys.executable, "-c", f"for n in {names}: print(__import__(n).__file__)"],
            cwd=self._folder, env=self._environment(), capture_output=True, text=True, check=False,
        )  # fmt: skip
        strangers = [line for line in found.stdout.splitlines() if not line.startswith(str(self._folder))]
        if found.returncode != 0 or strangers:
            raise WorkshopError(
                f"expected {', '.join(names)} from {self._folder}, found {strangers or found.stderr}; run make setup"
            )
