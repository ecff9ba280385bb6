# SPDX-License-Identifier: Apache-2.0
"""How long a finger's design takes: best of 16 starts, exact gradients beside finite differences on the same kernel.

Power and pinch follow the index finger of the recorded hand that ships with softgrip_design. No hook was recorded; its
target is what Fig 4.5 describes: the middle and the distal joint close, the proximal one hardly.
"""

from __future__ import annotations

import dataclasses
import math
import os
import statistics
import sys

import numpy as np

from softgrip_design import hand
from softgrip_design.design import Task, published_on
from softgrip_design.objective import FollowTrajectory, Weights
from softgrip_design.optimiser import optimise
from softgrip_design.target import STEPS, DesignTarget
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model.friction.published import published
from softgrip_testing.benchmark_claim import claim, no_options, spread, timed

GOAL_S = 0.15
RUNS, PEER_RUNS = 15, 5
#: Shares of the joints and the whole deflection of the hook [rad].
HOOK_SHARES, HOOK_DEFLECTION_RAD = (0.10, 0.52, 0.38), math.radians(140.0)


def hook_target() -> DesignTarget:
    """Return joints that close in fixed shares."""
    total = HOOK_DEFLECTION_RAD * np.arange(1, STEPS + 1) / STEPS
    return DesignTarget(total, np.outer(total, HOOK_SHARES))


def main() -> int:
    """Measure and print one claim per grasp; 1 when gradients and finite differences find different designs."""
    no_options(__doc__)
    task = Task(published("braid-tpu-chapter4").law)
    objectives = {grasp: task.objective(load(SHIPPED / f"hand_{grasp}.csv"), "index") for grasp in ("power", "pinch")}
    objectives["hook"] = FollowTrajectory(
        hand.blank("index"), task.law, hook_target(), Weights(), hand.THICKNESS_BOUNDS_MM, hand.ROUTING_BOUNDS_MM
    )
    numerical = dataclasses.replace(task.search, exact=False)
    for grasp, objective in objectives.items():
        ours, theirs = optimise(objective, task.search), optimise(objective, numerical)
        if not abs(ours.value - theirs.value) < 0.01 * theirs.value:
            print(f"{grasp}: {ours.value} with gradients, {theirs.value} without: no claim", file=sys.stderr)
            return 1
        exact = timed(lambda o=objective: optimise(o, task.search), RUNS)
        peer = timed(lambda o=objective: optimise(o, numerical), PEER_RUNS)
        compared = "; ".join(f"{name} {e:.2f} deg {f:.1f} N" for name, (e, f) in published_on(objective).items())
        claim(
            f"design time {grasp}",
            statistics.median(exact),
            "s",
            better="lower",
            goal=GOAL_S,
            runs=RUNS,
            peer="SLSQP with finite differences, same kernel, starts and threads",
            peer_value=statistics.median(peer),
            note=f"{spread(exact, 'ms', 1e3)}, {task.search.starts} starts on {os.cpu_count()} cores, "
            f"{ours.evaluations} evaluations, peer {theirs.evaluations}; error {objective.error_deg(ours.x):.2f} deg, "
            f"force {objective.force_n(ours.x):.2f} N; designs of Fig 4.4 on this target: {compared}",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
