# SPDX-License-Identifier: Apache-2.0
"""Make the recorded bags of this folder anew: one shift of the emulated cell, through the shipped launch file.

Run after a deliberate change of what a node computes: ``python tests/replay/make_bags.py``. The excerpts carry what
the replayed nodes read and what they said, no camera frames.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from softgrip_bag.excerpt import excerpt
from softgrip_bag.reader import read

HERE = Path(__file__).resolve().parent / "bags"
LONGEST = 600.0  # [s] for a shift
SECOND = 1_000_000_000
TENDON_TOPICS = {"/tendon/state", "/cell/state", "/friction/active"}

#: name -> topics, topic whose first message is the start, time before and after it [s]
EXCERPTS = {
    "closings": (
        TENDON_TOPICS | {"/finger/measured", "/finger/predicted", "/finger/residual"},
        "/finger/residual",
        (0.5, 6.0),
    ),
    "shapes": (TENDON_TOPICS | {"/shape/predicted"}, "/shape/predicted", (0.3, 0.7)),
    "calibration": ({"/rig/sample", "/friction/active", "/rig/stage", "/load_cell/wrench"}, "/rig/sample", (1.0, 10.0)),
}


def main() -> int:
    """Record a shift, or take a bag, and cut the excerpts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bag", type=Path, help="cut a bag that is there already")
    parser.add_argument("--seed", type=int, default=1, help="of the emulated cell")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softgrip-replay-bags-") as folder:
        bag = options.bag or record(Path(folder), options.seed)
        for name, (topics, first, (before, after)) in EXCERPTS.items():
            start = next(message.received for message in read(bag, {first}))
            shutil.rmtree(HERE / name, ignore_errors=True)
            since, until = start - round(before * SECOND), start + round(after * SECOND)
            count = excerpt(bag, HERE / name, topics, since, until)
            size = sum(file.stat().st_size for file in (HERE / name).iterdir())
            sys.stdout.write(f"{name}: {count} messages, {size / 1e3:.0f} kB\n")
    return 0


def record(folder: Path, seed: int) -> Path:
    """Run a shift; returns its bag."""
    command = ["ros2", "launch", "softgrip_bringup", "demo.launch.yaml", f"out:={folder}", f"seed:={seed}"]
    subprocess.run([*command, f"wire_dir:={folder / 'wires'}"], timeout=LONGEST, check=True)
    return next((folder / "bags").iterdir())


if __name__ == "__main__":
    sys.exit(main())
