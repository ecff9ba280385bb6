# SPDX-License-Identifier: Apache-2.0
"""Where a solved mesh leaves what its materials are known for: measured range and stability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.materials import Ogden, SolidMaterial
from softgrip_model.gdfe.mesh import Mesh, shape_slopes

Array = NDArray[np.float64]


def principal_stretches(mesh: Mesh, displacement: Array) -> Array:
    """Return the principal stretches of every element at its centre, (m, 3), largest first.

    Args:
        mesh: at rest.
        displacement: (n, 3).
    """
    slopes = shape_slopes(np.zeros(3))
    rest = np.einsum("eak,aj->ekj", mesh.nodes[mesh.hexes], slopes)
    here = np.einsum("eak,aj->ekj", (mesh.nodes + displacement)[mesh.hexes], slopes)
    return np.asarray(np.linalg.svd(here @ np.linalg.inv(rest), compute_uv=False))


def warnings_of(mesh: Mesh, materials: Sequence[SolidMaterial], displacement: Array) -> list[str]:
    """Return one sentence for every material that is stretched, compressed or sheared further than it is known for.

    Args:
        mesh: at rest.
        materials: in the order of the mesh's numbers.
        displacement: (n, 3).
    """
    stretches = principal_stretches(mesh, displacement)
    found = []
    for number, material in enumerate(materials):
        own = np.flatnonzero(mesh.materials == number)
        if not len(own):
            continue
        low, high = material.strain_range
        for past, worst, word, limit in (
            (stretches[own, 0] - 1.0 > high, own[np.argmax(stretches[own, 0])], "stretched", high),
            (stretches[own, 2] - 1.0 < low, own[np.argmin(stretches[own, 2])], "compressed", low),
        ):
            if past.any():
                strain = stretches[worst, 0 if word == "stretched" else 2] - 1.0
                found.append(
                    f"{material.name}: {word} to a strain of {strain:.2f} in element {worst}, known up to {limit:.2f} "
                    f"({int(past.sum())} elements beyond)"
                )
        if isinstance(material, Ogden):
            unstable = own[~material.stable(stretches[own])]
            if len(unstable):
                found.append(
                    f"{material.name}: not stable (Drucker) in {len(unstable)} elements, as in element {unstable[0]} "
                    f"at stretches {', '.join(f'{s:.2f}' for s in stretches[unstable[0]])}"
                )
    return found
