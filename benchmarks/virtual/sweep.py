# SPDX-License-Identifier: Apache-2.0
"""10,000 designs swept by one and by two of Dask's workers: the same results to the bit, and how well two share them.

`--grasps` sweeps virtual grasps instead (90 of one emulated cell). On a computer with less than two free cores the
efficiency says more about the computer than about the sweep.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from softgrip_sweep import ResultsStore, SweepTask, dask_pool, run_sweep
from softgrip_sweep.studies import designs, grasps
from softgrip_testing.benchmark_claim import claim

#: For each of two motions.
SAMPLES = 5000


def swept(tasks: Sequence[SweepTask], warm_up: Sequence[SweepTask], workers: int, folder: Path) -> float:
    """Do all tasks with so many workers; return how long it took once they were up [s]."""
    with dask_pool(workers) as pool:
        run_sweep(warm_up * workers, ResultsStore(folder / "warm-up"), pool)
        begun_s = time.perf_counter()
        run_sweep(tasks, ResultsStore(folder), pool)
        return time.perf_counter() - begun_s


def results(folder: Path) -> dict[str, bytes]:
    """Return the files of a store."""
    return {path.name: path.read_bytes() for path in (folder / "results").iterdir()}


def main() -> None:
    """Sweep twice and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grasps", action="store_true", help="virtual grasps instead of designs")
    options = parser.parse_args()
    tasks = grasps.tasks([1]) if options.grasps else designs.tasks(designs.DesignSpace(samples=SAMPLES))
    warm_up = designs.tasks(designs.DesignSpace(profiles=(), samples=2, seed=2))
    with tempfile.TemporaryDirectory() as folder:
        one, two = Path(folder) / "one", Path(folder) / "two"
        one_s, two_s = swept(tasks, warm_up, 1, one), swept(tasks, warm_up, 2, two)
        mine, theirs = results(one), results(two)
    differing = sum(mine.get(name) != theirs.get(name) for name in mine.keys() | theirs.keys())
    done = "90 virtual grasps" if options.grasps else f"{2 * SAMPLES} designs and 3 profiles for 2 motions"
    claim(
        "results that differ", differing, "", better="lower", goal=0, runs=len(mine),
        note=f"{done} in {len(mine)} tasks, by one worker and by two",
    )  # fmt: skip
    claim(
        "efficiency", one_s / two_s / 2.0, "", better="higher", goal=None, runs=2, peer="one worker", peer_value=1.0,
        note=f"{one_s:.1f} s by one worker, {two_s:.1f} s by two, on {os.cpu_count()} cores",
    )  # fmt: skip


if __name__ == "__main__":
    main()
