# SPDX-License-Identifier: Apache-2.0
"""What the cable does on printed TPU, in the finger's own law: the rig's material pair, seen otherwise.

The rig's cable follows the law of rig/truth.py. A finger is printed from the same material and strung with the same
cable, but its law here is another: a coefficient that falls with tension as a power law, plus a bite at each edge.
The two agree where they are fitted to each other and nowhere exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from softgrip_emulator.rig.truth import FrictionTruth


@dataclass(frozen=True)
class PlantSurface:
    """ln(T1/T2) = coefficient (T2 / 5 N)^-exponent angle + bite."""

    coefficient: float
    exponent: float
    bite: float


@cache
def surface_of(seed: int) -> PlantSurface:
    """The cable on its surface for a seed, from a fit to the rig's truth over the finger's angles and tensions."""
    rig = FrictionTruth.from_seed(seed)
    angle, tension = (grid.ravel() for grid in np.meshgrid(np.linspace(0.1, 1.0, 10), np.geomspace(1.0, 15.0, 10)))
    target = np.log(rig.ratio(angle, tension))
    best: tuple[float, PlantSurface] | None = None
    for exponent in np.linspace(0.02, 0.6, 59):
        columns = np.stack([(tension / 5.0) ** -exponent * angle, np.ones_like(angle)], axis=1)
        (coefficient, bite), *_ = np.linalg.lstsq(columns, target, rcond=None)
        loss = float(((columns @ [coefficient, bite] - target) ** 2).sum())
        if best is None or loss < best[0]:
            best = (loss, PlantSurface(float(coefficient), float(exponent), float(max(bite, 0.0))))
    assert best is not None
    return best[1]
