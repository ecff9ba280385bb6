# SPDX-License-Identifier: Apache-2.0
"""Environments: steps a second beside MuJoCo's of the exported hand, and a learned grasp beside the manager's own.

`steps rate` counts steps of GraspProduct-v0, 50 ms of the cell each with servos, driver and product; the peer is as
much time of MuJoCo's own step of the exported hand, which has none of these. `learned grasp` runs the shipped policy on
cells that no training drew, with products that Table 4.2 says power fingers hold; the peer is the manager's own grasp.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import gymnasium
import mujoco
import numpy as np

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.products import TableMark
from softgrip_description import shipped_hand
from softgrip_description.mjcf import mjcf_of
from softgrip_gym import GraspPolicy, GraspProduct
from softgrip_gym.cross_entropy import run_episode
from softgrip_gym.tendons import PERIOD_S
from softgrip_model.finger import JointModel
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_sweep.intervals import wilson
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.virtual_grasps import GraspBlock, ProductSet, grasp_products

SECONDS = 4.0
#: No training draws a cell below 1000.
UNSEEN_CELLS = 3


def rate(step: Callable[[], None]) -> float:
    """Return how often something can be done a second of processor time."""
    begun_s, count = time.process_time(), 0
    while time.process_time() - begun_s < SECONDS:
        step()
        count += 1
    return count / (time.process_time() - begun_s)


def environment_rate() -> float:
    """Return steps of GraspProduct-v0 a second, resets left out."""
    env = GraspProduct(hold_s=1e6)
    env.reset(seed=1, options={"product": "apple"})
    action = np.full(3, 0.3, np.float32)
    return rate(lambda: env.step(action) and None)


def mujoco_rate(joint_model: JointModel) -> float:
    """Return how many periods of an action MuJoCo steps the exported hand through a second."""
    profile = load_directory(shipped_directory())["power"]
    hand = shipped_hand()
    mounted = {slot: (profile.id, profile.finger(slot)) for slot in hand.slots}
    model = mujoco.MjModel.from_xml_string(mjcf_of(hand, mounted, profile.material, joint_model=joint_model))
    data = mujoco.MjData(model)
    steps = round(PERIOD_S / model.opt.timestep)
    return rate(lambda: mujoco.mj_step(model, data, nstep=steps))


def processes(number: int) -> float:
    """Return steps a second of elapsed time of environments in processes of their own."""
    envs = gymnasium.make_vec("softgrip/FingerReach-v0", num_envs=number, vectorization_mode="async")
    try:
        envs.reset(seed=1)
        action = np.full((number, 1), 0.3, np.float32)
        begun_s, count = time.perf_counter(), 0
        while time.perf_counter() - begun_s < SECONDS:
            envs.step(action)
            count += number
        return count / (time.perf_counter() - begun_s)
    finally:
        envs.close()


def learned(cell: int, products: list[str]) -> list[tuple[str, bool]]:
    """Return which products the shipped policy holds in a cell."""
    env, policy = GraspProduct(), GraspPolicy.load()
    return [(name, run_episode(env, policy, cell, {"cell": cell, "copy": 1, "product": name})[1]) for name in products]


def managed(cell: int, products: list[str]) -> list[tuple[str, bool]]:
    """Return which products the manager's own grasp holds in a cell."""
    block = GraspBlock(ProductSet.TUNED, cell, "power")
    return [(one.product, one.outcome == "GRIPPED") for one in grasp_products(block, products)]


def share(found: list[tuple[str, bool]]) -> tuple[float, str]:
    """Return the held share [%] and how sure it is."""
    held = sum(is_held for _, is_held in found)
    low, high = wilson(held, len(found))
    lost = sorted({name for name, is_held in found if not is_held})
    return 100.0 * held / len(found), f"{100 * low:.0f} to {100 * high:.0f} %, lost: {', '.join(lost) or '-'}"


def main() -> None:
    """Measure and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=UNSEEN_CELLS, help="unseen cells, twelve products each")
    options = parser.parse_args()
    ours, theirs, flexures = environment_rate(), mujoco_rate(JointModel.HINGE), mujoco_rate(JointModel.FLEXURE)
    claim(
        "steps rate", ours, "1/s", better="higher", goal=None, runs=1,
        peer="MuJoCo's step of the exported hand with hinges, without servos, driver and product", peer_value=theirs,
        note="50 ms of the cell a step, by processor time; "
        f"MuJoCo's hand of flexures {flexures:.0f}; FingerReach-v0 by the clock {processes(1):.0f} steps a "
        f"second in one process, {processes(2):.0f} in two",
    )  # fmt: skip
    products = [name for name, one in read_catalogue().products.items() if one.marks.get("power") is TableMark.SUCCESS]
    cells = range(1, options.cells + 1)
    with ProcessPoolExecutor(2) as pool:
        policy = [one for found in pool.map(learned, cells, [products] * len(cells)) for one in found]
        manager = [one for found in pool.map(managed, cells, [products] * len(cells)) for one in found]
    value, sure = share(policy)
    peer, peer_sure = share(manager)
    claim(
        "learned grasp", value, "%", better="higher", goal=None, runs=len(policy), peer="the manager's own grasp",
        peer_value=peer, note=f"held 5 s, power fingers, {len(cells)} unseen cells; learned {sure}; manager "
        f"{peer_sure}",
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
