# SPDX-License-Identifier: Apache-2.0
"""Where a solved mesh leaves what its materials are known for: measured range and stability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.materials import Ogden, SolidMaterial, VolumeShape, calibrated_shape_stress
from softgrip_model.gdfe.mesh import Mesh, shape_slopes
from softgrip_model.gdfe.solver import ConstitutiveLaw

Array = NDArray[np.float64]

#: From this share of the stress on the rigorous law is worth its cost, in elements whose stress is at least this share
#: of the largest: elsewhere it decides nothing.
MAX_LAW_ERROR, _WEIGHTY = 0.10, 0.25


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


def law_error(material: Ogden, stretches: Array, shape: VolumeShape = VolumeShape.PROJ) -> Array:
    """Return by how much the calibrated law's stress is off the rigorous one's at principal stretches (n, 3), (n,).

    Of the stresses that change a body's shape; a share of the rigorous ones, 0 where there are none.
    """
    exact = material.shape_stress(stretches)
    size = np.linalg.norm(exact, axis=-1)
    apart = np.linalg.norm(calibrated_shape_stress(material, stretches, shape) - exact, axis=-1)
    return np.asarray(np.divide(apart, size, out=np.zeros_like(size), where=size > 1e-9 * material.shear_modulus))


def warnings_of(
    mesh: Mesh,
    materials: Sequence[SolidMaterial],
    displacement: Array,
    law: ConstitutiveLaw = ConstitutiveLaw.CALIBRATED,
) -> list[str]:
    """Return one sentence for every material that is stretched, compressed or sheared further than it is known for.

    With the calibrated law also for every one whose strain is of a kind that this law does not know.

    Args:
        mesh: at rest.
        materials: in the order of the mesh's numbers.
        displacement: (n, 3).
        law: that it was found with.
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
            if law is ConstitutiveLaw.CALIBRATED:
                found += _law_warning(material, stretches, own)
    return found


def _law_warning(material: Ogden, stretches: Array, own: NDArray[np.intp]) -> list[str]:
    stress = np.linalg.norm(material.shape_stress(stretches[own]), axis=-1)
    error = law_error(material, stretches[own])
    past = (error > MAX_LAW_ERROR) & (stress >= _WEIGHTY * stress.max())
    if not past.any():
        return []
    worst = int(np.argmax(np.where(past, error, 0.0)))
    text = (
        f"{material.name}: the law 'calibrated' is off by {100.0 * error[worst]:.0f} % of the stress in element "
        f"{own[worst]} at stretches {', '.join(f'{s:.2f}' for s in stretches[own[worst]])} and by more than "
        f"{100.0 * MAX_LAW_ERROR:.0f} % in {int(past.sum())} elements; take the law 'rigorous'"
    )
    return [text]
