# SPDX-License-Identifier: Apache-2.0
"""Run every benchmark, collect one JSON line a claim, and draw how each stands to its goal."""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.progress import Progress

HERE = Path(__file__).resolve().parent
LONGEST = 600.0  # [s] for one script


def main() -> int:
    """Run the scripts; the exit code is 1 when one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="file for the JSON lines; the picture goes beside it")
    parser.add_argument("scripts", nargs="*", help="names of scripts; none = all")
    arguments = parser.parse_args()
    known = {path.stem: path for path in sorted(HERE.glob("*/*.py")) if not path.name.startswith("_")}
    unknown = set(arguments.scripts) - set(known)
    if unknown:
        parser.error(f"expected names of {', '.join(known)}, found {', '.join(sorted(unknown))}")
    scripts = [known[name] for name in arguments.scripts or known]
    claims: list[dict[str, Any]] = []
    failed = []
    with Progress() as progress:
        task = progress.add_task("benchmarks", total=len(scripts))
        for script in scripts:
            progress.update(task, description=script.stem)
            found = run(script)
            if not found:
                failed.append(script.stem)
            claims += found
            progress.advance(task)
    arguments.out.write_text("".join(json.dumps(claim) + "\n" for claim in claims))
    draw(claims, arguments.out.with_suffix(".png"))
    print(f"{len(claims)} claims in {arguments.out}" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return 1 if failed else 0


def run(script: Path) -> list[dict[str, Any]]:
    """Return the claims that a script prints, none when it fails."""
    try:
        done = subprocess.run(
            [sys.executable, str(script)], capture_output=True, text=True, timeout=LONGEST, check=True, cwd=HERE.parent
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        print(f"{script.name}: {error}\n{error.stderr or ''}", file=sys.stderr)
        return []
    return [{"script": script.stem, **json.loads(line)} for line in done.stdout.splitlines()]


def draw(claims: list[dict[str, Any]], path: Path) -> None:
    """Draw value over goal for every claim that has one, on a logarithmic axis; right of 1 is better than the goal."""
    rows = []
    for claim in claims:
        goal, value = claim["goal"], claim["value"]
        if goal and value and goal > 0 and value > 0:
            factor = goal / value if claim["better"] == "lower" else value / goal
            rows.append((f"{claim['script']}: {claim['name']}", factor))
    if not rows:
        return
    figure = Figure(figsize=(9.0, 0.28 * len(rows) + 1.2), layout="constrained")
    axes = figure.subplots()
    names, factors = zip(*reversed(rows), strict=True)
    axes.barh(names, [math.log10(f) for f in factors], color=["#0b6e4f" if f >= 1 else "#c8553d" for f in factors])
    axes.axvline(0.0, color="#22312b", lw=1.0)
    ticks = sorted({-1, 0, 1, *(round(math.log10(f)) for f in factors)})
    axes.set_xticks(ticks, [f"{10.0**t:g}x" for t in ticks])
    axes.set_xlabel("better than its goal by")
    axes.tick_params(axis="y", labelsize=7)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    sys.exit(main())
