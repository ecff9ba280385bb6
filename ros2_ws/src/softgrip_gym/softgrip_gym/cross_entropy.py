# SPDX-License-Identifier: Apache-2.0
"""Cross-entropy method: draw policies, keep the best, draw nearer to them (Rubinstein and Kroese 2004, chapter 4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from softgrip_gym.grasp_policy import GraspPolicy
from softgrip_gym.grasp_product import GraspProduct

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Where the search begins: 12 N on every tendon whatever the product, winding at half speed; and how far around
#: [parameters].
START = np.array([12.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.5])
SPREAD = np.array([6.0, 3.0, 3.0, 6.0, 3.0, 3.0, 0.25])


@dataclass(frozen=True)
class TrainingSettings:
    """Of a training.

    Attributes:
        finger_set: that is trained with.
        products: names.
        generations: of policies.
        policies: drawn in each.
        elite: of them that the next generation is drawn around.
        episodes: that each policy is tried in; a generation shares cells and products.
        hold_s: that a product has to hang in training [s].
        seed: of all draws.
    """

    finger_set: str = "power"
    products: tuple[str, ...] = ()
    generations: int = 5
    policies: int = 12
    elite: int = 4
    episodes: int = 6
    hold_s: float = 1.0
    seed: int = 1


def run_episode(
    env: GraspProduct, policy: GraspPolicy, seed: int | None = None, options: dict[str, object] | None = None
) -> tuple[float, bool]:
    """Run a policy for an episode; return the sum of its rewards and whether the product was held."""
    observation, _ = env.reset(seed=seed, options=options)
    total, ended = 0.0, False
    info: dict[str, object] = {}
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        total += float(reward)
        ended = terminated or truncated
    return total, bool(info["is_success"])


def mean_return(settings: TrainingSettings, parameters: Sequence[float], first_seed: int) -> float:
    """Return the mean reward of a policy over the episodes of a generation; called by a worker."""
    env = GraspProduct(settings.finger_set, settings.products, hold_s=settings.hold_s)
    policy = GraspPolicy.of(settings.finger_set, np.array(parameters))
    return float(np.mean([run_episode(env, policy, first_seed + episode)[0] for episode in range(settings.episodes)]))


def train(
    settings: TrainingSettings, pool: Executor, report: Callable[[int, float, float], None] = lambda *_: None
) -> GraspPolicy:
    """Train a policy; the same settings give the same policy with any number of workers.

    Args:
        settings: of the training.
        pool: who runs the episodes.
        report: called after each generation with its number, the mean reward of all and of the elite.
    """
    rng = np.random.default_rng(settings.seed)
    mean, spread = START.copy(), SPREAD.copy()
    for generation in range(settings.generations):
        drawn = mean + spread * rng.standard_normal((settings.policies, len(mean)))
        first_seed = 1_000_000 * settings.seed + generation * settings.episodes
        futures = [pool.submit(mean_return, settings, one.tolist(), first_seed) for one in drawn]
        returns = np.array([future.result() for future in futures])
        elite = drawn[np.argsort(-returns, kind="stable")[: settings.elite]]
        mean, spread = elite.mean(axis=0), elite.std(axis=0) + 0.05 * SPREAD
        report(generation, float(returns.mean()), float(np.sort(returns)[-settings.elite :].mean()))
    return GraspPolicy.of(settings.finger_set, mean)
