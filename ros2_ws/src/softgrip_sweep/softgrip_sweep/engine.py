# SPDX-License-Identifier: Apache-2.0
"""Do the tasks that have no result yet, and keep every result and every failure as it comes."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass

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
    futures = {pool.submit(run_task, task.function, dict(task.arguments)): task for task in pending}
    failed: dict[str, str] = {}
    for future in as_completed(futures):
        task = futures[future]
        error = future.exception()
        if error is None:
            store.save(task, future.result())
        else:
            failed[task.key] = "".join(traceback.format_exception_only(error)).strip()
            store.save_failure(task, "".join(traceback.format_exception(error)))
        advance()
    return SweepSummary(
        done=len(pending) - len(failed),
        resumed=len(tasks) - len(pending),
        failed=tuple((task, failed[task.key]) for task in pending if task.key in failed),
    )
