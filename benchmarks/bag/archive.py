# SPDX-License-Identifier: Apache-2.0
"""An archive of fifty bags answers SQL with the figures of `report --json` of each bag.

The bags are stretches of the recorded ones in tests/replay/bags, ten of each: with grasps, closings, friction and
faults, and some that begin or end in the middle of these. All go in twice, the second time under other names, and a
broken one goes in between. `queries that differ` counts figures of the archive that are not the report's, files that
the second round changed, and broken bags that were not listed and left out.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from softgrip_bag.archive import Archive, connect
from softgrip_bag.nodes.commands import archive, report
from softgrip_bag.reader import bag_digest, read
from softgrip_testing.bag_excerpt import excerpt
from softgrip_testing.benchmark_claim import claim, no_options

RECORDED = Path(__file__).resolve().parents[2] / "tests" / "replay" / "bags"
NAMES = ("by_rosbag2_source", "calibration", "closings", "grasps", "shapes")
STRETCHES = 10
#: `report` rounds to four digits.
SAME = 1e-3


def make_bags(folder: Path) -> list[Path]:
    """Cut the recorded bags into stretches that overlap by half; return the new bags."""
    bags = []
    for name in NAMES:
        times = [message.received for message in read(RECORDED / name)]
        begin, step = min(times), (max(times) - min(times)) // (STRETCHES + 1)
        for k in range(STRETCHES):
            bags.append(folder / f"{name}_{k}")
            excerpt(RECORDED / name, bags[-1], None, begin + k * step, begin + (k + 2) * step)
    return bags


def break_bag(bag: Path, folder: Path) -> Path:
    """Return a copy of a bag whose end is missing."""
    broken = folder / "broken"
    shutil.copytree(bag, broken)
    file = next(broken.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-500])
    return broken


def archived(bags: Sequence[Path], place: Path) -> str:
    """Add bags by the command; return what it says about those that it skips."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        archive.main([*map(str, bags), "--to", str(place), "--tables-only"])
    return said.getvalue()


def reported(bag: Path) -> dict[str, Any]:
    """Return what `report --json` prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        report.main([str(bag), "--json"])
    return dict(json.loads(printed.getvalue()))


QUESTIONS = {
    "messages": "SELECT messages, dropped FROM bags WHERE bag = ?",
    "grasps": "SELECT product, outcome, reason, 1e3 * latency_s, duration_s FROM grasps WHERE bag = ? ORDER BY stamp",
    "closings": "SELECT profile, finger, frames, tip_error_mean, tip_error_max FROM closings WHERE bag = ?",
    "friction": "SELECT id, law, 100 * average_error, r_squared, points, verdict FROM friction WHERE bag = ?",
    "faults": "SELECT source, name, text FROM alarms WHERE bag = ?",
    "latency": "SELECT source, result, matched, unanswered, 1e3 * from_stamp_p99_s FROM latencies WHERE bag = ?",
}


def expected(said: dict[str, Any]) -> dict[str, list[tuple[Any, ...]]]:
    """Return the report's answer to each question."""
    return {
        "messages": [(said["messages"], said["dropped"])],
        "grasps": _rows(said["grasps"], "product", "outcome", "reason", "latency_ms", "duration_s"),
        "closings": _rows(said["closings"], "profile", "finger", "frames", "tip_error_pct_mean", "tip_error_pct_max"),
        "friction": _rows(said["friction"], "id", "law", "average_error_pct", "r_squared", "points", "verdict"),
        "faults": _rows(said["faults"], "source", "name", "text"),
        "latency": [
            (one["source"], one["result"], one["matched"], one["unanswered"], one["from_stamp_ms"][2])
            for one in said["latency"]
        ],
    }


def _rows(found: Sequence[dict[str, Any]], *names: str) -> list[tuple[Any, ...]]:
    return [tuple(one[name] for name in names) for one in found]


def differing(answers: Sequence[tuple[Any, ...]], figures_of_report: Sequence[tuple[Any, ...]]) -> Iterator[str]:
    """Yield every figure that is not the report's."""
    if len(answers) != len(figures_of_report):
        yield f"{len(answers)} rows in place of {len(figures_of_report)}"
        return
    for ours, theirs in zip(sorted(answers, key=_key), sorted(figures_of_report, key=_key), strict=True):
        yield from (f"{a} in place of {b}" for a, b in zip(ours, theirs, strict=True) if not _same(a, b))


def _key(row: tuple[Any, ...]) -> tuple[str, ...]:
    return tuple(str(value) for value in row if not isinstance(value, float))


def _same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, float) or isinstance(theirs, float):
        none = (theirs is None) and (ours is None or ours != ours)  # noqa: PLR0124  NaN
        return none or (None not in (ours, theirs) and abs(ours - theirs) <= SAME * max(abs(theirs), 1e-3))
    return bool(ours == theirs)


def main() -> None:
    """Archive, ask, and print the claim."""
    no_options(__doc__)
    with tempfile.TemporaryDirectory() as name:
        folder, place = Path(name), Path(name) / "archive"
        (folder / "again").mkdir()
        bags = make_bags(folder)
        begun_s = time.perf_counter()
        said = archived([*bags, break_bag(bags[-1], folder)], place)
        took_s = time.perf_counter() - begun_s
        wrong = [] if said.count("skipped") == 1 and "broken" in said else [f"skipped: {said}"]
        before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}
        wrong += [
            f"second round: {text}" for text in [archived([_renamed(bag, folder) for bag in bags], place)] if text
        ]
        wrong += [] if before == {p: p.read_bytes() for p in place.rglob("*") if p.is_file()} else ["files changed"]
        connection = connect(Archive(str(place)))
        figures: Counter[str] = Counter()
        for bag in bags:
            figures_of_report, key = expected(reported(bag)), [bag_digest(bag)]
            for question, sql in QUESTIONS.items():
                answers = connection.execute(sql, key).fetchall()
                figures[question] += sum(map(len, figures_of_report[question]))
                wrong += [f"{bag.name} {question}: {text}" for text in differing(answers, figures_of_report[question])]
        connection.close()
    counted = ", ".join(f"{question} {count}" for question, count in figures.items())
    claim(
        "queries that differ", len(wrong), "", better="lower", goal=0, runs=sum(figures.values()),
        note=f"figures of {len(bags)} bags ({counted}), archived in {took_s:.0f} s; {'; '.join(wrong[:3])}",
    )  # fmt: skip


def _renamed(bag: Path, folder: Path) -> Path:
    copy = folder / "again" / f"again_{bag.name}"
    shutil.copytree(bag, copy)
    return copy


if __name__ == "__main__":
    sys.exit(main())
