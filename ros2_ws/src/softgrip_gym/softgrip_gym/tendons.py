# SPDX-License-Identifier: Apache-2.0
"""What a policy sees and sends, the same in virtual time and in the live cell. Pure values, no environment.

An observation holds, for each tendon, pulled length, speed, tension and commanded length, in that order. An action is,
for each tendon, how fast the commanded length changes, as a share of `MAX_RATE_M_S`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from softgrip_cell.products import Product

    Array = NDArray[np.float32]

#: Tendons in the order of observations and actions.
SLOTS: Final = ("index", "middle", "thumb")
#: [s] between two actions, five periods of the driver's loop at 100 Hz.
PERIOD_S: Final = 0.05
#: Largest commanded length [m] and speed [m/s].
MAX_LENGTH_M: Final = 0.020
MAX_RATE_M_S: Final = 0.030
#: What one unit of an observation is: length [m], speed [m/s], tension [N], size of a product [m], mass [kg].
LENGTH_UNIT_M: Final = 0.020
SPEED_UNIT_M_S: Final = 0.050
TENSION_UNIT_N: Final = 20.0
SIZE_UNIT_M: Final = 0.100
MASS_UNIT_KG: Final = 0.500
#: Bound of an observation in these units; nothing physical comes near it.
BOUND: Final = 10.0


def next_targets(targets_m: NDArray[np.float64], action: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the commanded lengths [m] one period after an action, (n,)."""
    step_m = MAX_RATE_M_S * PERIOD_S * np.clip(np.asarray(action, float), -1.0, 1.0)
    return np.clip(targets_m + step_m, 0.0, MAX_LENGTH_M)


def tendon_observation(
    lengths_m: Sequence[float], speeds_m_s: Sequence[float], tensions_n: Sequence[float], targets_m: Sequence[float]
) -> Array:
    """Return the tendons' part of an observation, (4 n,)."""
    return np.concatenate([
        np.asarray(lengths_m) / LENGTH_UNIT_M,
        np.asarray(speeds_m_s) / SPEED_UNIT_M_S,
        np.asarray(tensions_n) / TENSION_UNIT_N,
        np.asarray(targets_m) / LENGTH_UNIT_M,
    ]).astype(np.float32)  # fmt: skip


def product_observation(product: Product) -> Array:
    """Return what the catalogue knows of a product: length, width, height, mass, (4,)."""
    return np.array([*(size / SIZE_UNIT_M for size in product.size_m), product.mass_kg / MASS_UNIT_KG], np.float32)
