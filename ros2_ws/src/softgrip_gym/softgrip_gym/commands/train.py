# SPDX-License-Identifier: Apache-2.0
"""Train a small grasp policy by the cross-entropy method in virtual time: CPU minutes."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from softgrip_gym.cross_entropy import TrainingSettings, train
from softgrip_testing.virtual_grasps import FINGER_SETS, ProductSet, catalogue


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, or 2 when the policy cannot be written."""
    default = TrainingSettings()
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_gym train",
        description=__doc__,
        epilog="`ros2 run softgrip_gym run_policy FILE` runs it in the live emulated cell. See docs/virtual.md.",
    )
    parser.add_argument("output", type=Path, help="file for the policy (.json)")
    parser.add_argument("--finger-set", choices=FINGER_SETS, default=default.finger_set)
    parser.add_argument(
        "--products",
        nargs="+",
        default=[],
        choices=list(catalogue(ProductSet.TUNED)),
        metavar="NAME",
        help="default: all",
    )
    parser.add_argument("--generations", type=int, default=default.generations)
    parser.add_argument("--policies", type=int, default=default.policies, help="a generation")
    parser.add_argument("--episodes", type=int, default=default.episodes, help="a policy and generation")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count(), help="processes; the policy does not depend on them"
    )
    options = parser.parse_args(args)
    if min(options.generations, options.policies - default.elite, options.episodes, options.workers) < 1:
        parser.error(f"expected at least one generation, episode and worker, and more than {default.elite} policies")
    settings = TrainingSettings(
        finger_set=options.finger_set,
        products=tuple(options.products),
        generations=options.generations,
        policies=options.policies,
        episodes=options.episodes,
        seed=options.seed,
    )
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        policy = train(
            settings,
            pool,
            lambda number, every, elite: print(f"generation {number}: {every:.2f} all, {elite:.2f} elite"),
        )
    try:
        policy.save(options.output)
    except OSError as error:
        print(f"{options.output}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    print(f"{options.output}: {policy}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
