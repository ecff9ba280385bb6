# SPDX-License-Identifier: Apache-2.0
"""Two computers of a Dask cluster, simulated by two workers with folders of their own behind a scheduler."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from softgrip_testing.waiting import wait_until

#: On a busy machine a scheduler is up within this [s].
START_S = 120.0


@dataclass(frozen=True)
class DaskComputers:
    """What runs.

    Attributes:
        scheduler: its address, ``tcp://host:port``.
        workers: a process each, which holds no other process: to kill it is to switch its computer off.
    """

    scheduler: str
    workers: tuple[subprocess.Popen[bytes], ...]


@contextmanager
def dask_computers(folder: Path, number: int = 2) -> Iterator[DaskComputers]:
    """Start a scheduler and workers by Dask's own command, each in a folder below ``folder``; end them afterwards."""
    with ExitStack() as stack:
        address_file = folder / "scheduler.json"
        _start(
            stack, folder / "scheduler",
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(address_file),
        )  # fmt: skip
        wait_until(address_file.exists, "a scheduler", START_S)
        scheduler = str(json.loads(address_file.read_text())["address"])
        workers = tuple(
            _start(
                stack, folder / f"computer_{k + 1}",
                "worker", scheduler, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", "space",
            )
            for k in range(number)
        )  # fmt: skip
        yield DaskComputers(scheduler, workers)


def _start(stack: ExitStack, folder: Path, *command: str) -> subprocess.Popen[bytes]:
    folder.mkdir(parents=True)
    log = stack.enter_context((folder / "log").open("wb"))
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *command], cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log
    )
    stack.callback(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
