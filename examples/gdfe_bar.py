# SPDX-License-Identifier: Apache-2.0
"""Bend a soft beam by a weight at its end, with hyperelastic finite elements, beside beam theory."""

import numpy as np

from softgrip_model.gdfe import Linear, Solver, SolverSettings, Supports, bar
from softgrip_model.gdfe.march import Loading, march

LENGTH_MM, SIDE_MM, MODULUS_MPA, FORCE_N = 60.0, 6.0, 10.0, 0.02


def main() -> tuple[float, float]:
    """Return the sag of the end [mm]: finite elements, and F L^3 / 3 E I with shear."""
    mesh = bar((LENGTH_MM, SIDE_MM, SIDE_MM), (60, 6, 6))
    root, end = (mesh.nodes_where(mesh.nodes[:, 0] == x) for x in (0.0, LENGTH_MM))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(root)
    solver = Solver(
        mesh, [Linear("soft", MODULUS_MPA, 0.3)], supports, settings=SolverSettings(window=30, step_limit=1.5)
    )
    weight = np.zeros_like(mesh.nodes)
    weight[end, 1] = -FORCE_N / len(end)
    bent = march(solver, lambda share: Loading(load=share * weight), increments=1).last

    sag = -float(bent.displacement[end, 1].mean())
    inertia, shear = SIDE_MM**4 / 12, MODULUS_MPA / 2.6
    theory = FORCE_N * LENGTH_MM**3 / (3 * MODULUS_MPA * inertia) + FORCE_N * LENGTH_MM / (5 / 6 * shear * SIDE_MM**2)
    print(f"sag {sag:.3f} mm, beam theory {theory:.3f} mm; the root carries {bent.reaction[root, 1].sum():.4f} N")
    return sag, theory


if __name__ == "__main__":
    main()
