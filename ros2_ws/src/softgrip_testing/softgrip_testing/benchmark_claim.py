# SPDX-License-Identifier: Apache-2.0
"""One benchmark claim = one JSON line on stdout."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence


def no_options(description: str | None) -> None:
    """Answer ``--help`` with what a script without options measures, and refuse anything else on its command line."""
    argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()


def claim(
    name: str,
    value: float,
    unit: str,
    *,
    better: str,
    goal: float | None,
    runs: int,
    note: str,
    peer: str = "",
    peer_value: float | None = None,
) -> None:
    """Print one claim.

    Args:
        name: as in docs/architecture.md; kept from run to run.
        value: median of the runs, in ``unit``.
        unit: of value and peer_value.
        better: "lower" or "higher".
        goal: what the project aims at, same unit; None where there is no aim.
        runs: how many times it was measured.
        note: the spread, and what was measured.
        peer: what it is compared with, measured in the same run; empty = nothing.
        peer_value: the peer's figure.
    """
    if better not in {"lower", "higher"}:
        raise ValueError(f"better: expected 'lower' or 'higher', found {better!r}")
    ratio = None
    if peer_value is not None and value and peer_value:
        ratio = peer_value / value if better == "lower" else value / peer_value
    line = {
        "name": name,
        "value": value,
        "unit": unit,
        "better": better,
        "goal": goal,
        "peer": peer,
        "peer_value": peer_value,
        "ratio": ratio,
        "runs": runs,
        "note": note,
    }
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def timed(work: Callable[[], object], runs: int, *, repeat: int = 1) -> list[float]:
    """Return the seconds that each of ``runs`` runs took, per repetition; one untimed run goes first."""
    work()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        for _ in range(repeat):
            work()
        seconds.append((time.perf_counter() - start) / repeat)
    return seconds


def spread(values: Sequence[float], unit: str, scale: float = 1.0) -> str:
    """Return "min .. max unit, n runs" of values times scale."""
    low, high = min(values) * scale, max(values) * scale
    return f"median {statistics.median(values) * scale:.4g}, {low:.4g} .. {high:.4g} {unit} in {len(values)} runs"
