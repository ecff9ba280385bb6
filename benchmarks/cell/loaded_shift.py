# SPDX-License-Identifier: Apache-2.0
"""The same shift on any computer: `make demo` beside busy loops, or on one core, gives what it gives alone.

Each seed's shift runs once as it is and once loaded. Compared are the grasps' outcomes, the mean tip errors of the
three sets, the friction coefficients and the verdict of the bag's replay. Resumes in its folder.

    python benchmarks/cell/loaded_shift.py --seeds 1-20
    python benchmarks/cell/loaded_shift.py --seeds 1-20 --one-core --busy 0
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from softgrip_testing.benchmark_claim import claim, spread

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def busy(loops: int, cores: Sequence[str]) -> Iterator[None]:
    """Keep so many loops running that do nothing."""
    running = [subprocess.Popen([*cores, sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def shift(seed: int, folder: Path, loops: int, cores: Sequence[str]) -> dict[str, Any]:
    """Run the demo of a seed, unless it has ended there before; returns its summary, exit code and wall time [s]."""
    note, out = folder / "exit.json", folder / "demo"
    if not note.exists():
        folder.mkdir(parents=True, exist_ok=True)
        command = [*cores, sys.executable, str(ROOT / "tools/demo.py"), str(out), "--seed", str(seed), "panel:=false"]
        environment = os.environ | {"ROS_HOME": str(folder / "home")}
        began_s = time.monotonic()
        with busy(loops, cores), (folder / "output.txt").open("w", encoding="utf-8") as output:
            ended = subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, env=environment, check=False)
        note.write_text(json.dumps({"code": ended.returncode, "wall_s": time.monotonic() - began_s}))
    found: dict[str, Any] = json.loads(note.read_text())
    summary = out / "summary.json"
    found["summary"] = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
    return found


def compare(alone: Mapping[str, Any], loaded: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of a seed's two shifts is the same."""
    found: dict[str, Any] = {"codes": [alone["code"], loaded["code"]], "wall_s": [alone["wall_s"], loaded["wall_s"]]}
    first, second = alone["summary"], loaded["summary"]
    if first is None or second is None:
        return found | {"grasps": 0, "same": 0, "differ": ["one of the shifts did not reach its end"]}
    pairs = list(zip(first["grasps"], second["grasps"], strict=True))
    differ = [
        f"{a['product']}: {a['outcome']} alone, {b['outcome']} loaded" for a, b in pairs if a["outcome"] != b["outcome"]
    ]
    tips = [
        abs(a["tip_error_pct_mean"] - b["tip_error_pct_mean"])
        for a, b in zip(first["closings"], second["closings"], strict=True)
    ]
    coefficients = ("alpha", "n", "epsilon", "lambda")
    friction = max(abs(second["friction"][name] / first["friction"][name] - 1.0) for name in coefficients)
    return found | {
        "grasps": len(pairs),
        "same": len(pairs) - len(differ),
        "differ": differ,
        "tip_difference_pct": max(tips),
        "friction_difference_pct": 100.0 * friction,
        "replay_identical": [bool(one["replay"]["identical"]) for one in (first, second)],
    }


def read_seeds(text: str) -> list[int]:
    """Return seeds from `3` or `1-20`."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main() -> None:
    """Run the shifts and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=read_seeds, default=read_seeds("1"), help="3, or 1-20")
    parser.add_argument("--busy", type=int, default=4, help="busy loops beside the loaded shifts")
    parser.add_argument("--one-core", action="store_true", help="run the loaded shifts, and their loops, on one core")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "loaded_shift", help="folder of the shifts")
    options = parser.parse_args()
    cores = ["taskset", "-c", "0"] if options.one_core else []
    load = f"{options.busy} loops" + (" on one core" if options.one_core else "")
    seeds = {}
    for seed in track(options.seeds, "shifts, alone and loaded", console=Console(stderr=True)):
        alone = shift(seed, options.out / f"alone_{seed}", 0, [])
        loaded = shift(seed, options.out / f"{load.replace(' ', '_')}_{seed}", options.busy, cores)
        seeds[seed] = compare(alone, loaded)
    each = "; ".join(f"seed {seed}: {', '.join(one['differ'])}" for seed, one in seeds.items() if one["differ"])
    walls = [spread([one["wall_s"][i] for one in seeds.values()], "s") for i in (0, 1)]
    note = f"{len(seeds)} seeds beside {load}; alone {walls[0]}; loaded {walls[1]}; {each or 'no grasp differs'}"
    ended = [one["codes"] == [0, 0] and all(one.get("replay_identical", [False])) for one in seeds.values()]
    grasps, same = (sum(one[name] for one in seeds.values()) for name in ("grasps", "same"))
    tips, friction = (
        [one.get(name, math.inf) for one in seeds.values()]
        for name in ("tip_difference_pct", "friction_difference_pct")
    )
    runs = len(seeds)
    figures = (
        ("loaded shift: ended, replay identical", sum(ended) / runs, "1", "higher", 1.0),
        ("loaded shift: grasps as alone", same / max(grasps, 1), "1", "higher", 299.0 / 300.0),
        ("loaded shift: mean tip error against alone", max(tips), "% of length", "lower", 0.3),
        ("loaded shift: friction coefficients against alone", max(friction), "%", "lower", 1.0),
    )
    for name, value, unit, better, goal in figures:
        claim(name, value, unit, better=better, goal=goal, runs=runs, note=note)


if __name__ == "__main__":
    main()
