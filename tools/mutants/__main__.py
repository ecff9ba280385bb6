# SPDX-License-Identifier: Apache-2.0
"""Run deliberate errors (mutants) against the tests that must notice them.

``python tools/mutants`` runs the whole list, ``--area guards`` one area, ``--only ID ...`` some; ``--check`` runs
nothing and tells whether every mutant still applies. Results are kept in out/mutants.jsonl: a second run takes up
where the first was ended, and does again only what changed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from campaign import SURVIVED, UNNOTICED, Campaign, Result
from mutant import ListError, Mutant, check_list, find_ripe, read_list
from report import format_report
from workshop import WorkshopError

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def main() -> int:
    """Return 0 when every counted mutant was noticed, 1 when one survived, 2 when the list or the tests are wrong."""
    options = _options()
    try:
        listed = read_list(HERE / "list")
        mutants = _chosen(listed, options)
        problems = check_list(mutants, ROOT)
        if problems:
            raise ListError("\n".join(problems))
        ripe = find_ripe(listed, ROOT)
        if ripe:
            print(f"pending mutants apply by now, take their `pending` out: {', '.join(ripe)}")
        if options.check:
            print(f"{len(mutants)} mutants apply, {sum(bool(mutant.pending) for mutant in listed)} are pending")
            return 0
        if options.fresh:
            options.results.unlink(missing_ok=True)
        results = Campaign(ROOT, options.results, options.workers, _print_result, quick=options.quick).run(mutants)
    except (ListError, WorkshopError) as error:
        print(error, file=sys.stderr)
        return 2
    print(format_report(mutants, results))
    equivalent = {mutant.id for mutant in mutants if mutant.equivalent}
    return int(any(result.outcome in (SURVIVED, UNNOTICED) and result.id not in equivalent for result in results))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--area", action="append", default=[], help="only this area; may be given more than once")
    parser.add_argument("--only", nargs="+", default=[], metavar="ID", help="only these mutants")
    parser.add_argument("--pending", action="store_true", help="also those that wait for code to be merged")
    parser.add_argument("--check", action="store_true", help="only check that every mutant applies")
    parser.add_argument("--quick", action="store_true", help="run the named tests only, not the area's whole suite")
    parser.add_argument("--fresh", action="store_true", help="forget the results of earlier runs")
    parser.add_argument("--workers", type=int, default=2, help="mutants at a time (default 2)")
    parser.add_argument("--results", type=Path, default=ROOT / "out" / "mutants.jsonl", help="where results are kept")
    return parser.parse_args()


def _chosen(listed: list[Mutant], options: argparse.Namespace) -> list[Mutant]:
    areas = {mutant.area for mutant in listed}
    ids = {mutant.id for mutant in listed}
    if strange := set(options.area) - areas:
        raise ListError(f"expected areas out of {sorted(areas)}, found {sorted(strange)}")
    if strange := set(options.only) - ids:
        raise ListError(f"expected ids of the list, found {sorted(strange)}")
    return [
        mutant
        for mutant in listed
        if (not options.area or mutant.area in options.area)
        and (not options.only or mutant.id in options.only)
        and (options.pending or not mutant.pending)
    ]


def _print_result(result: Result) -> None:
    print(f"{result.outcome:<9}{result.area}/{result.id}  {result.seconds:.1f} s  {result.by}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
