# SPDX-License-Identifier: Apache-2.0
"""10,000 designs swept by one of Dask's workers, by two, and by two computers of which one dies: the same to the bit.

`--grasps` sweeps virtual grasps instead, 90 of each of `--cells`. One worker and two do the same tasks in turns, so
that what else the computer does slows both; the two computers are workers with folders of their own behind a
scheduler, and one is killed once a third of the tasks is done. On a computer with less than two free cores the
efficiency by the clock says more about the computer than about the sweep; that by processor time says what sharing
costs.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import psutil

from softgrip_sweep import ResultsStore, SweepTask, dask_pool, run_sweep
from softgrip_sweep.studies import designs, grasps
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.dask_computers import dask_computers

#: For each of two motions.
SAMPLES = 5000
#: Tasks that one worker does, and then two.
TURN = 6


@dataclass(frozen=True)
class Cost:
    """What some tasks cost: elapsed time and processor time of all processes [s]."""

    elapsed_s: float
    processor_s: float


def swept(tasks: Sequence[SweepTask], store: ResultsStore, pool: Executor) -> Cost:
    """Do tasks; return what they cost."""
    begun_s, spent_s = time.perf_counter(), processor_s()
    run_sweep(tasks, store, pool)
    return Cost(time.perf_counter() - begun_s, processor_s() - spent_s)


def processor_s() -> float:
    """Return the processor time of this process, which schedules, and of all below it [s]."""
    this = psutil.Process()
    return float(sum(sum(one.cpu_times()[:2]) for one in (this, *this.children(recursive=True))))


def in_turns(tasks: Sequence[SweepTask], one: ResultsStore, two: ResultsStore) -> list[tuple[Cost, Cost]]:
    """Do all tasks by one worker and by two; return what each turn cost them."""
    warm_up = designs.tasks(designs.DesignSpace(profiles=(), samples=2, seed=2))
    turns = []
    with dask_pool(1) as single, dask_pool(2) as pair, tempfile.TemporaryDirectory() as folder:
        for pool in (single, pair):
            run_sweep(warm_up * 2, ResultsStore(Path(folder) / str(id(pool))), pool)
        for begin in range(0, len(tasks), TURN):
            some = tasks[begin : begin + TURN]
            if len(turns) % 2:
                by_pair, by_single = swept(some, two, pair), swept(some, one, single)
            else:
                by_single, by_pair = swept(some, one, single), swept(some, two, pair)
            turns.append((by_single, by_pair))
    return turns


def with_a_death(tasks: Sequence[SweepTask], store: ResultsStore, folder: Path) -> None:
    """Do all tasks by two computers, and switch one off once a third is done."""
    done = 0
    with dask_computers(folder) as computers, dask_pool(scheduler=computers.scheduler) as pool:

        def advance() -> None:
            nonlocal done
            done += 1
            if done == max(1, len(tasks) // 3):
                computers.workers[0].kill()

        run_sweep(tasks, store, pool, advance)


def results(store: ResultsStore) -> dict[str, bytes]:
    """Return the files of a store."""
    return {path.name: path.read_bytes() for path in (store.folder / "results").iterdir()}


def main() -> None:
    """Sweep three times and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grasps", action="store_true", help="virtual grasps instead of designs")
    parser.add_argument("--cells", type=int, default=1, help="emulated cells, 90 grasps each")
    options = parser.parse_args()
    tasks = (
        grasps.tasks(range(1, options.cells + 1))
        if options.grasps
        else designs.tasks(designs.DesignSpace(samples=SAMPLES))
    )
    with tempfile.TemporaryDirectory() as folder:
        one, two, two_computers = (ResultsStore(Path(folder) / name) for name in ("one", "two", "computers"))
        turns = in_turns(tasks, one, two)
        with_a_death(tasks, two_computers, Path(folder) / "network")
        mine, others = results(one), [results(two), results(two_computers)]
    differing = sum(mine.get(name) != other.get(name) for other in others for name in mine.keys() | other.keys())
    done = (
        f"{90 * options.cells} virtual grasps"
        if options.grasps
        else f"{2 * SAMPLES} designs and 3 profiles for 2 motions"
    )
    claim(
        "results that differ", differing, "", better="lower", goal=0, runs=len(mine),
        note=f"{done} in {len(mine)} tasks, by one worker, by two, and by two computers of which one died",
    )  # fmt: skip
    shares = sorted(single.elapsed_s / pair.elapsed_s / 2.0 for single, pair in turns)
    single_s, pair_s = (sum(turn[k].processor_s for turn in turns) for k in (0, 1))
    claim(
        "efficiency", statistics.median(shares), "", better="higher", goal=None, runs=len(turns), peer="one worker",
        peer_value=1.0,
        note=f"median of {len(turns)} turns, {shares[0]:.2f} to {shares[-1]:.2f}, by the clock on {os.cpu_count()} "
        f"cores; by processor time {single_s / pair_s:.2f}: {single_s:.0f} s with one worker, {pair_s:.0f} s with two",
    )  # fmt: skip


if __name__ == "__main__":
    main()
