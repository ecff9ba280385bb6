# SPDX-License-Identifier: Apache-2.0
"""Do the tasks that have no result yet, and keep every result and every failure as it comes."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from typing import Any

from softgrip_sweep.pools import WORKER_DEATHS_ALLOWED, lost_its_result
from softgrip_sweep.store import ResultsStore
from softgrip_sweep.task import SweepTask, run_task


@dataclass(frozen=True)
class SweepSummary:
    """What became of a sweep's tasks.

    Attributes:
        done: tasks that this run did.
        resumed: tasks whose result was there already.
        failed: tasks without a result, with the error.
    """

    done: int
    resumed: int
    failed: tuple[tuple[SweepTask, str], ...]


def run_sweep(
    tasks: Sequence[SweepTask],
    store: ResultsStore,
    pool: Executor,
    advance: Callable[[], None] = lambda: None,
) -> SweepSummary:
    """Do all tasks that the store has no result of.

    Args:
        tasks: in any order; the results do not depend on it.
        store: of results.
        pool: who does them; whichever it is, the results are the same.
        advance: called for each task that has ended, also for those that need not be done.

    Raises:
        SweepError: the store cannot be written.
    """
    pending = [task for task in tasks if not store.has(task)]
    for _ in range(len(tasks) - len(pending)):
        advance()
    futures = {_submit(pool, task): task for task in pending}
    failed: dict[str, str] = {}
    lost: Counter[str] = Counter()
    while futures:
        for future in wait(futures, return_when=FIRST_COMPLETED).done:
            task = futures.pop(future)
            error = future.exception()
            if error is None:
                store.save(task, future.result())
            elif lost_its_result(error) and lost[task.key] < WORKER_DEATHS_ALLOWED:
                lost[task.key] += 1
                futures[_submit(pool, task)] = task
                continue
            else:
                failed[task.key] = "".join(traceback.format_exception_only(error)).strip()
                store.save_failure(task, "".join(traceback.format_exception(error)))
            advance()
    return SweepSummary(
        done=len(pending) - len(failed),
        resumed=len(tasks) - len(pending),
        failed=tuple((task, failed[task.key]) for task in pending if task.key in failed),
    )


def _submit(pool: Executor, task: SweepTask) -> Future[Any]:
    return pool.submit(run_task, task.function, dict(task.arguments))
