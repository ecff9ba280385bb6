# SPDX-License-Identifier: Apache-2.0
"""Load a data set of `export --lerobot` with LeRobot itself, compare its statistics, and train a small policy on it.

LeRobot brings PyTorch (5 GB), so it wants an environment of its own:

    python3.12 -m venv /tmp/lerobot && /tmp/lerobot/bin/pip install "lerobot[dataset]==0.6.1"
    HF_HUB_OFFLINE=1 /tmp/lerobot/bin/python tools/lerobot_check.py OUT

Returns 0 when the statistics of every episode agree to 1e-3 and the policy's loss falls.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from lerobot.datasets.compute_stats import compute_episode_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader

STEPS = 100
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
    """Train a small network on state -> the next three actions; return the mean loss of its first and last ten."""
    torch.manual_seed(1)
    ahead = [0.05, 0.1, 0.15]
    data = LeRobotDataset("softgrip/grasps", root=root, delta_timestamps={"action": ahead})
    stats = {name: {k: torch.tensor(v, dtype=torch.float32) for k, v in data.meta.stats[name].items()}
             for name in ("observation.state", "action")}  # fmt: skip
    size = len(stats["action"]["mean"])
    network = torch.nn.Sequential(torch.nn.Linear(size, 64), torch.nn.ReLU(), torch.nn.Linear(64, size * len(ahead)))
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    losses: list[float] = []
    while len(losses) < STEPS:
        for batch in DataLoader(data, batch_size=16, shuffle=True):
            state, action = (
                (batch[name] - stats[name]["mean"]) / (stats[name]["std"] + 1e-6)
                for name in ("observation.state", "action")
            )
            loss = torch.nn.functional.mse_loss(network(state).reshape(action.shape), action)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss))
    return float(np.mean(losses[:10])), float(np.mean(losses[STEPS - 10 : STEPS]))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
