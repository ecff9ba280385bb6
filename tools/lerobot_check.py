# SPDX-License-Identifier: Apache-2.0
"""Load a data set of `export --lerobot` with LeRobot itself, compare its statistics, and have it train a small policy.

LeRobot brings PyTorch (5 GB), so it wants an environment of its own:

    python3.12 -m venv /tmp/lerobot && /tmp/lerobot/bin/pip install "lerobot[dataset,training]==0.6.1"
    HF_HUB_OFFLINE=1 /tmp/lerobot/bin/python tools/lerobot_check.py OUT

Returns 0 when the statistics of every episode agree to 1e-3 and the policy's loss falls.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from lerobot.datasets.compute_stats import compute_episode_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset

STEPS = 100
#: LeRobot's ACT (Zhao et al. 2023) with a narrow transformer, for ten minutes of a core; nothing is downloaded.
SMALL_POLICY = (
    "--policy.type=act",
    "--policy.device=cpu",
    "--policy.push_to_hub=false",
    "--policy.pretrained_backbone_weights=null",
    "--policy.use_vae=false",
    "--policy.dim_model=64",
    "--policy.n_heads=4",
    "--policy.dim_feedforward=128",
    "--policy.chunk_size=10",
    "--policy.n_action_steps=10",
    "--policy.optimizer_lr=3e-4",
    "--policy.optimizer_lr_backbone=1e-4",
    "--batch_size=2",
    "--num_workers=0",
    "--log_freq=1",
    f"--steps={STEPS}",
)
#: LeRobot takes the standard deviation from running sums of squares, which costs digits where it is small.
TOLERANCE = 1e-3


def main(root: Path) -> int:
    """Check a data set."""
    data = LeRobotDataset("softgrip/grasps", root=root)
    print(f"{data.num_episodes} episodes, {len(data)} frames at {data.fps} Hz, {len(data.meta.tasks)} tasks")
    worst = max(difference(data, root, number) for number in range(data.num_episodes))
    print(f"statistics: largest relative difference from LeRobot's own {worst:.1e}")
    first, last = train(root)
    print(f"policy: loss {first:.3f} at first, {last:.3f} after {STEPS} steps")
    return 0 if worst < TOLERANCE and last < first else 1


def difference(data: Any, root: Path, number: int) -> float:
    """Return the largest relative difference of an episode's min, max, mean and std from what LeRobot computes."""
    episode = data.meta.episodes[number]
    frames = [data[index] for index in range(episode["dataset_from_index"], episode["dataset_to_index"])]
    features = {name: one for name, one in data.meta.features.items() if one["dtype"] not in {"image", "video"}}
    columns = {name: np.stack([np.asarray(one[name]).reshape(-1) for one in frames]) for name in features}
    theirs = compute_episode_stats(columns, features)
    ours = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()[number]
    worst = 0.0
    for name in features:
        for stat in ("min", "max", "mean", "std"):
            mine, other = (np.ravel(np.asarray(x, float)) for x in (ours[f"stats/{name}/{stat}"], theirs[name][stat]))
            scale = np.maximum(np.maximum(np.abs(mine), np.abs(other)), np.abs(np.ravel(theirs[name]["max"])) + 1e-6)
            worst = max(worst, float(np.max(np.abs(mine - other) / scale)))
    return worst


def train(root: Path) -> tuple[float, float]:
    """Have lerobot-train make a small policy; return the mean loss of its first ten steps and of its last ten."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = subprocess.Popen(
            [
                Path(sys.executable).with_name("lerobot-train"),
                "--dataset.repo_id=softgrip/grasps",
                f"--dataset.root={root}",
                f"--output_dir={folder}/policy",
                *SMALL_POLICY,
            ],
            stderr=subprocess.STDOUT,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert trainer.stdout is not None
        losses = []
        for line in trainer.stdout:
            print(line, end="")
            if found := re.search(r" loss:([0-9.]+)", line):
                losses.append(float(found.group(1)))
    if trainer.wait() or len(losses) != STEPS:
        raise SystemExit(f"expected {STEPS} losses of lerobot-train, found {len(losses)}, exit {trainer.returncode}")
    return float(np.mean(losses[:10])), float(np.mean(losses[-10:]))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
