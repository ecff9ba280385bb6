# SPDX-License-Identifier: Apache-2.0
"""Share of deliberate errors in safety-relevant code that a test notices, by area and over all.

The whole list takes longer than a benchmark may: what ``make mutants`` has found for the present code is taken from
out/mutants.jsonl, and of what is not there as many mutants are run as the time allows, drawn with a fixed seed.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import defaultdict
from pathlib import Path

from softgrip_testing.benchmark_claim import claim

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "mutants"))

from campaign import SURVIVED, Campaign, Result, read_results  # noqa: E402  found by the line above
from mutant import Mutant, check_list, read_list  # noqa: E402

GOAL = 95.0
"""[%] of the counted mutants."""


def main() -> int:
    """Print one claim over all areas; a stale list is an error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=240.0, help="for mutants without a result (default 240)")
    parser.add_argument("--results", type=Path, default=ROOT / "out" / "mutants.jsonl")
    options = parser.parse_args()
    mutants = [mutant for mutant in read_list(ROOT / "tools" / "mutants" / "list") if not mutant.pending]
    if problems := check_list(mutants, ROOT):
        print("\n".join(problems), file=sys.stderr)
        return 2
    counted = {mutant.id: mutant for mutant in mutants if not mutant.equivalent}
    results = known_results(counted, options.results)
    results |= run_some([one for one in counted.values() if one.id not in results], options)
    noticed = sum(result.outcome != SURVIVED for result in results.values())
    claim(
        "score",
        100.0 * noticed / max(1, len(results)),
        "%",
        better="higher",
        goal=GOAL,
        runs=len(results),
        note=f"{noticed} of {len(results)} mutants noticed, {len(counted)} in the list, "
        f"{len(mutants) - len(counted)} more argued as equivalent; {by_area(results)}",
    )
    return 0


def known_results(mutants: dict[str, Mutant], path: Path) -> dict[str, Result]:
    """Return the results that still fit the code and its tests, by id."""
    digests = {name: mutant.digest(ROOT) for name, mutant in mutants.items()}
    return {result.id: result for result in read_results(path) if result.digest == digests.get(result.id)}


def run_some(mutants: list[Mutant], options: argparse.Namespace) -> dict[str, Result]:
    """Run mutants in a random order until the time is over; those in real time are left out."""
    todo = [mutant for mutant in mutants if not mutant.is_real_time]
    random.Random(1).shuffle(todo)
    end = time.monotonic() + options.seconds
    found: dict[str, Result] = {}
    while todo and time.monotonic() < end:
        batch, todo = todo[:4], todo[4:]
        for result in Campaign(ROOT, options.results, 2, lambda _: None).run(batch):
            found[result.id] = result
    return found


def by_area(results: dict[str, Result]) -> str:
    """Return noticed / run for every area."""
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for result in results.values():
        counts[result.area][0] += result.outcome != SURVIVED
        counts[result.area][1] += 1
    return ", ".join(f"{area} {noticed}/{run}" for area, (noticed, run) in sorted(counts.items()))


if __name__ == "__main__":
    sys.exit(main())
