# SPDX-License-Identifier: Apache-2.0
"""What a campaign found, as a table by area and a list of survivors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from campaign import SURVIVED, UNNOTICED, Result
from mutant import Mutant


def compute_score(mutants: Sequence[Mutant], results: Sequence[Result]) -> tuple[int, int]:
    """Return (noticed, counted) mutants; equivalent ones are not counted."""
    counted = {mutant.id for mutant in mutants if not mutant.equivalent}
    outcomes = [result.outcome for result in results if result.id in counted]
    return sum(outcome not in (SURVIVED, UNNOTICED) for outcome in outcomes), len(outcomes)


def format_report(mutants: Sequence[Mutant], results: Sequence[Result]) -> str:
    """Return the table by area, and each survivor with what it means."""
    by_area: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        by_area[result.area].append(result)
    lines = [f"{'area':<16}{'mutants':>8}{'noticed':>9}{'by named tests':>16}{'equivalent':>12}{'score':>9}{'time':>9}"]
    for area, rows in by_area.items():
        lines.append(_row(area, [mutant for mutant in mutants if mutant.area == area], rows))
    lines.append(_row("all", mutants, list(results)))
    known = {mutant.id: mutant for mutant in mutants}
    for result in results:
        if result.outcome in (SURVIVED, UNNOTICED) and not known[result.id].equivalent:
            lines += ["", *_survivor(known[result.id], result.outcome)]
    return "\n".join(lines)


def _row(area: str, mutants: Sequence[Mutant], results: Sequence[Result]) -> str:
    noticed, counted = compute_score(mutants, results)
    equivalent = sum(bool(mutant.equivalent) for mutant in mutants)
    targeted = sum(result.targeted for result in results)
    score = f"{100.0 * noticed / counted:.1f} %" if counted else "-"
    minutes = f"{sum(result.seconds for result in results) / 60.0:.1f} min"
    return f"{area:<16}{counted:>8}{noticed:>9}{targeted:>16}{equivalent:>12}{score:>9}{minutes:>9}"


def _survivor(mutant: Mutant, outcome: str) -> list[str]:
    return [
        f"{outcome.upper()} {mutant.area}/{mutant.id}: {mutant.why}",
        f"  in {mutant.file}:",
        *(f"  - {line}" for line in mutant.old.splitlines()),
        *(f"  + {line}" for line in mutant.new.splitlines()),
    ]
