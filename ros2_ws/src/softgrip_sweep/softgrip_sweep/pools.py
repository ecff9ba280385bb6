# SPDX-License-Identifier: Apache-2.0
"""Who does the tasks: Dask's workers on this computer or behind a scheduler, or plain processes.

Dask notices a worker that dies and gives its tasks to another; plain processes do not, and suffice for a benchmark.
"""

from __future__ import annotations

import multiprocessing
import os
import traceback
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from softgrip_sweep.errors import SweepError

#: A task whose worker died so often fails for good (Dask: `distributed.scheduler.allowed-failures`).
WORKER_DEATHS_ALLOWED = 3
#: [s] until a scheduler has to answer.
CONNECT_TIMEOUT_S = 10.0


@contextmanager
def dask_pool(workers: int | None = None, scheduler: str = "") -> Iterator[Executor]:
    """Give Dask's workers.

    Args:
        workers: processes on this computer, one core each; None: one for each core. Not used with a scheduler.
        scheduler: ``tcp://host:port`` of a running Dask scheduler; empty: processes of this computer, as long as the
            context lasts.

    Raises:
        SweepError: Dask is not installed, or no scheduler answers.
    """
    try:
        import dask  # noqa: PLC0415  an extra
        from distributed import Client, LocalCluster  # noqa: PLC0415  an extra
    except ImportError as error:
        raise SweepError(f"expected Dask distributed, found {error}; `make study-setup` installs it") from error
    settings = {
        "distributed.scheduler.allowed-failures": WORKER_DEATHS_ALLOWED,
        "distributed.comm.timeouts.connect": CONNECT_TIMEOUT_S,
    }
    with dask.config.set(settings):
        if scheduler:
            try:
                client = Client(scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
            except (OSError, TimeoutError, ValueError) as error:
                raise SweepError(
                    f"expected a Dask scheduler at {scheduler}, found none: {error}; start one with `dask scheduler`"
                ) from error
            with client, client.get_executor(pure=False) as pool:
                yield pool
            return
        with (
            LocalCluster(
                n_workers=workers or os.cpu_count() or 1,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=50,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
            client.get_executor(pure=False) as pool,
        ):
            yield pool


def lost_its_result(error: BaseException) -> bool:
    """Whether a task was done and its worker died before the result had come: nobody's failure.

    Dask's executor (distributed/cfexecutor.py) takes such a result for an exception's parts, and raises ValueError.
    """
    frames = traceback.extract_tb(error.__traceback__)
    return isinstance(error, ValueError) and bool(frames) and Path(frames[-1].filename).name == "cfexecutor.py"


@contextmanager
def process_pool(workers: int | None = None) -> Iterator[Executor]:
    """Give plain processes of this computer; None: one for each core."""
    with ProcessPoolExecutor(workers or os.cpu_count() or 1, multiprocessing.get_context("spawn")) as pool:
        yield pool
