# SPDX-License-Identifier: Apache-2.0
"""Do many tasks on all cores or on a Dask cluster: virtual grasps, finger designs, or the replay of many bags."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from softgrip_demo.table42 import THESIS_RATE_PERCENT
from softgrip_model.friction.published import published_ids
from softgrip_sweep.engine import SweepSummary, run_sweep
from softgrip_sweep.errors import SweepError
from softgrip_sweep.intervals import wilson
from softgrip_sweep.pools import dask_pool
from softgrip_sweep.store import ResultsStore
from softgrip_sweep.studies import bags, designs, grasps
from softgrip_sweep.task import SweepTask
from softgrip_testing.virtual_grasps import FINGER_SETS, ProductSet, catalogue

_SHOWN_DESIGNS = 10


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, 1 when tasks failed or a replay differs, 2 when the sweep cannot be done."""
    options = _parser().parse_args(args)
    store = ResultsStore(options.results)
    try:
        tasks = _tasks(options)
        with dask_pool(options.workers, options.scheduler) as pool:
            summary = _with_progress(tasks, store, pool)
        found = [(task, store.load(task)) for task in tasks if store.has(task)]
    except SweepError as error:
        print(error, file=sys.stderr)
        return 2
    code = _show(options, found)
    return max(code, _report(summary, store))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_sweep sweep",
        description=__doc__,
        epilog="A sweep that was stopped goes on when it is started again with the same --results. After a change of "
        "the code choose another folder. See docs/virtual.md.",
    )
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--results", type=Path, required=True, metavar="FOLDER", help="one file a task")
    common.add_argument("--workers", type=_count, metavar="N", help="processes of this computer; default: one a core")
    common.add_argument("--scheduler", default="", metavar="tcp://HOST:PORT", help="a running Dask scheduler instead")
    common.add_argument("--json", action="store_true", help="print one JSON object a task instead of a table")
    kinds = parser.add_subparsers(dest="kind", required=True)

    one = kinds.add_parser("grasps", parents=[common], help="virtual grasps beside thesis Table 4.2")
    one.add_argument(
        "--cells", type=_count, default=grasps.CELLS, metavar="N", help="emulated cells; 12 make 1,080 grasps"
    )
    one.add_argument("--first-cell", type=_count, default=1, metavar="SEED", help="seed of the first one")
    one.add_argument(
        "--product-sets", nargs="+", type=ProductSet, default=list(ProductSet), choices=list(ProductSet), metavar="A|B",
        help="A: the emulator's, tuned towards the table; B: published masses and dimensions, frozen",
    )  # fmt: skip
    one.add_argument("--products", nargs="+", default=[], metavar="NAME", choices=list(catalogue(ProductSet.TUNED)))

    two = kinds.add_parser("designs", parents=[common], help="profiles and samples x friction x motions")
    two.add_argument("--motions", nargs="+", default=list(designs.MOTIONS), choices=designs.MOTIONS)
    two.add_argument("--friction", nargs="+", default=list(designs.FRICTION), choices=published_ids(), metavar="ID")
    two.add_argument("--profiles", nargs="*", default=list(designs.PROFILES), choices=designs.PROFILES)
    two.add_argument(
        "--samples", type=int, default=1000, metavar="N", help="of a Latin hypercube, a motion and friction"
    )
    two.add_argument("--seed", type=int, default=1, help="of the samples")

    three = kinds.add_parser("bags", parents=[common], help="replay every bag through the present code")
    three.add_argument("places", nargs="+", type=Path, help="bags, folders of bags, an archive")
    three.add_argument("--through", nargs="+", default=list(bags.NODES), choices=bags.NODES, metavar="NODE")
    three.add_argument("--tolerance", type=float, default=0.0, help="relative, for bags of another machine; 0 = exact")
    return parser


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, found {value}")
    return value


def _tasks(options: argparse.Namespace) -> list[SweepTask]:
    if options.kind == "grasps":
        seeds = range(options.first_cell, options.first_cell + options.cells)
        return grasps.tasks(seeds, options.product_sets, options.products)
    if options.kind == "designs":
        return designs.tasks(
            designs.DesignSpace(options.motions, options.friction, options.profiles, options.samples, options.seed)
        )
    return bags.tasks(bags.find_bags(options.places), options.through, options.tolerance)


def _with_progress(tasks: Sequence[SweepTask], store: ResultsStore, pool: Any) -> SweepSummary:
    columns = (TextColumn("tasks"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task("tasks", total=len(tasks))
        return run_sweep(tasks, store, pool, lambda: progress.advance(bar))


def _report(summary: SweepSummary, store: ResultsStore) -> int:
    """Print what was done, list what failed; return the exit code."""
    print(
        f"{summary.done} tasks done, {summary.resumed} were done before, {len(summary.failed)} failed", file=sys.stderr
    )
    for task, error in summary.failed:
        print(f"failed: {task}: {error} (more in {store.folder}/failures/{task.key}.json)", file=sys.stderr)
    return 1 if summary.failed else 0


def _show(options: argparse.Namespace, found: Sequence[tuple[SweepTask, Any]]) -> int:
    """Print the results; return the exit code."""
    if options.json:
        for task, result in found:
            print(json.dumps({"function": task.function, **task.arguments, "result": result}))
    elif options.kind == "grasps":
        _show_grasps(found, options.product_sets)
    elif options.kind == "designs":
        _show_designs(found)
    else:
        _show_bags(found)
    differs = options.kind == "bags" and any(result["verdict"] == "different" for _, result in found)
    return 1 if differs else 0


def _show_grasps(found: Sequence[tuple[SweepTask, Any]], product_sets: Sequence[ProductSet]) -> None:
    every = [grasp for task, result in found for grasp in grasps.grasps(task, result)]
    for product_set in product_sets:
        check = grasps.cross_check(every, product_set, "virtual time")
        if not check.tried:
            continue
        table = Table(
            "product", *FINGER_SETS, title=f"product set {product_set}: held/tried [95 % interval], Table 4.2"
        )
        for row in grasps.rows(check):
            table.add_row(*map(escape, row))
        rates = check.rates_percent()
        table.add_section()
        table.add_row(
            "success (thesis)",
            *(f"{rates.get(one, math.nan):.0f} ({THESIS_RATE_PERCENT[one]}) %" for one in FINGER_SETS),
        )
        Console().print(table)
        hits, total = grasps.agreement(check)
        low, high = wilson(hits, total)
        of_it = [grasp for grasp in every if grasp.block.product_set is product_set]
        print(
            f"product set {product_set}: {hits} of {total} marks of the table ({100 * hits / total:.0f} %, "
            f"{100 * low:.0f} to {100 * high:.0f}); {sum(grasp.is_true for grasp in of_it)} of {len(of_it)} "
            "verdicts are what the plant shows"
        )


def _show_designs(found: Sequence[tuple[SweepTask, Any]]) -> None:
    groups: dict[tuple[str, str], list[Any]] = {}
    for task, result in found:
        groups.setdefault((task.arguments["motion"], task.arguments["friction"]), []).extend(result)
    headings = [escape(heading) for heading in ("from", "error [deg]", "force [N]", "h, r [mm]")]
    for (motion, friction), tried in groups.items():
        table = Table(*headings, title=f"{motion}, {friction}: best of {len(tried)}")
        for one in designs.best(tried)[:_SHOWN_DESIGNS]:
            sizes = " ".join(f"{value:.1f}" for value in one["design_mm"])
            table.add_row(one["source"], f"{one['error_deg']:.2f}", f"{one['force_n']:.2f}", sizes)
        Console().print(table)


def _show_bags(found: Sequence[tuple[SweepTask, Any]]) -> None:
    table = Table("bag", "node", "verdict", "outputs", "detail")
    for task, result in found:
        row = (Path(task.arguments["bag"]).name, task.arguments["node"], result["verdict"], str(result["compared"]))
        table.add_row(*map(escape, row), escape(result["detail"][:100]))
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
