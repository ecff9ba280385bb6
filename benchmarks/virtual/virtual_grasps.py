# SPDX-License-Identifier: Apache-2.0
"""Grasps in virtual time beside thesis Table 4.2: products that were tuned towards it (A), and published ones (B).

`--cells 12` makes the 1,080 grasps of docs/virtual.md; the default is as many as fit a benchmark. The peer of the rate
is the same grasps in real time; that of the agreement says "success" whatever comes.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from softgrip_sweep import ResultsStore, process_pool, run_sweep
from softgrip_sweep.intervals import wilson
from softgrip_sweep.studies import grasps
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.virtual_grasps import ProductSet


def main() -> None:
    """Grasp and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=1, help="emulated cells, 90 grasps each")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    options = parser.parse_args()
    tasks = grasps.tasks(range(1, options.cells + 1))
    with tempfile.TemporaryDirectory() as folder, process_pool(options.workers) as pool:
        store = ResultsStore(Path(folder))
        begun_s = time.perf_counter()
        run_sweep(tasks, store, pool)
        took_s = time.perf_counter() - begun_s
        results = [(task, store.load(task)) for task in tasks]
    every = [one for task, result in results for one in grasps.grasps(task, result)]
    virtual_s = sum(one["duration_s"] for _, result in results for one in result)
    claim(
        "grasps rate", len(every) / took_s, "1/s", better="higher", goal=None, runs=len(every),
        peer="the same grasps in real time", peer_value=len(every) / virtual_s,
        note=f"{len(every)} grasps, {virtual_s:.0f} s of virtual time from command to verdict, in {took_s:.0f} s by "
        f"{options.workers} processes",
    )  # fmt: skip
    for product_set in ProductSet:
        check = grasps.cross_check(every, product_set, "virtual time")
        hits, total = grasps.agreement(check)
        low, high = wilson(hits, total)
        of_it = [one for one in every if one.block.product_set is product_set]
        differ = [f"{t.product}/{t.finger_set} ({t.mark})" for t in check.tried if not t.agrees]
        claim(
            f"agreement set {product_set}", 100.0 * hits / total, "%", better="higher", goal=None, runs=len(of_it),
            peer="always 'success'",
            peer_value=100.0 * sum(item.mark == "success" for item in check.tried) / total,
            note=f"95 % interval {100 * low:.0f} to {100 * high:.0f}; {sum(one.is_true for one in of_it)} of "
            f"{len(of_it)} verdicts are what the plant shows; differing: {', '.join(differ) or '-'}",
        )  # fmt: skip


if __name__ == "__main__":
    main()
