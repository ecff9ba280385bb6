# SPDX-License-Identifier: Apache-2.0
"""Choose the points worth measuring: nine of a hundred that say most about the law's coefficients."""

import numpy as np

from softgrip_model.friction.design import efficiency, optimal_design
from softgrip_model.friction.published import published


def main() -> tuple[float, float]:
    """Compare the best nine points with the usual grid of nine."""
    law = published("braid-tpu").law
    angle, load = (grid.ravel() for grid in np.meshgrid(np.radians(np.linspace(10, 90, 10)), np.linspace(2.0, 9.8, 10)))
    best = optimal_design(law, angle, load, count=9, seed=1)
    grid = [10 * i + j for i in (0, 4, 9) for j in (0, 4, 9)]
    for theta, tension in sorted({(round(np.degrees(angle[i])), round(load[i], 1)) for i in best}):
        print(f"wrap {theta:2d} deg, weight {1e3 * tension / 9.81:4.0f} g")
    chosen, usual = efficiency(law, angle, load, best), efficiency(law, angle, load, grid)
    print(f"efficiency: {chosen:.2f} chosen, {usual:.2f} on a grid")
    return chosen, usual


if __name__ == "__main__":
    main()
