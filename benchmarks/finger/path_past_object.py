# SPDX-License-Identifier: Apache-2.0
"""How many random fingers `follow` takes past a cylinder at their tip: closed, opened and closed again.

The finger is free up to 8 mm of pull; the cylinder of 6 mm radius then touches the tip, from a side that is drawn.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from softgrip_model.finger import Cylinder, Finger, JointModel, close, follow
from softgrip_model.friction.published import published
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.calculix_flexures import random_finger

LAW = published("braid-tpu-chapter4").law
#: With the first fifty `follow` was written; the others were never looked at.
SEEDS = range(4001, 4051), range(5001, 5301)
RADIUS_MM, FREE_MM = 6.0, 8.0
UP = np.arange(0.5, 16.1, 0.5)
PULLS = np.concatenate([UP, UP[-2:3:-1], UP[4:]])


def object_of(finger: Finger, seed: int) -> Cylinder:
    """Return a cylinder that the tip meets when it has been pulled by FREE_MM."""
    tip, then = close(finger, LAW, [FREE_MM, FREE_MM + 0.5]).tip_mm[0]
    side = math.atan2(*(then - tip)[::-1]) + np.random.default_rng(seed).uniform(-0.9, 0.9)
    return Cylinder((float(tip[0] + RADIUS_MM * math.cos(side)), float(tip[1] + RADIUS_MM * math.sin(side))), RADIUS_MM)


def goes_through(finger: Finger, seed: int) -> bool:
    """Whether the whole path is found."""
    return not follow(finger, LAW, PULLS, contacts=[object_of(finger, seed)]).failed.any()


def main() -> int:
    """Print the claim."""
    no_options(__doc__)
    for seeds in SEEDS:
        through = {
            model: sum(goes_through(random_finger(seed).with_joint_model(model), seed) for seed in seeds)
            for model in (JointModel.FLEXURE, JointModel.HINGE)
        }
        claim(
            "paths past an object", through[JointModel.FLEXURE], f"of {len(seeds)}", better="higher", goal=len(seeds),
            note="random fingers of mode F, cylinder at the tip, closed, opened, closed", runs=1,
            peer="mode P", peer_value=through[JointModel.HINGE],
        )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
