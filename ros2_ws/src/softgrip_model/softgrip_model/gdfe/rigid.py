# SPDX-License-Identifier: Apache-2.0
"""Whether supports hold a mesh: every connected part must be kept from all six rigid motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.mesh import Mesh
from softgrip_model.gdfe.solver import Supports

Array = NDArray[np.float64]

_MOTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


def check_held(mesh: Mesh, supports: Supports) -> None:
    """Refuse supports that leave a part of the mesh free.

    Raises:
        GdfeError: names an element of the part and the motion that nothing holds.
    """
    first = mesh.hexes[:, :1].repeat(7, axis=1).ravel()
    edges = coo_array((np.ones(len(first)), (first, mesh.hexes[:, 1:].ravel())), shape=(len(mesh.nodes),) * 2)
    parts, part_of = connected_components(edges, directed=False)
    for part in range(parts):
        nodes = np.flatnonzero(part_of == part)
        _, size, rows = np.linalg.svd(np.vstack([_held_motions(mesh, supports, nodes), np.zeros((6, 6))]))
        free = size < 1e-8 * max(1.0, size[0])
        if free.any():
            motion = _MOTIONS[int(np.argmax(np.abs(rows[np.argmax(free)])))]
            element = int(np.argmax(part_of[mesh.hexes[:, 0]] == part))
            raise GdfeError(
                f"the part with element {element} can move freely {motion}: no load could be held; "
                "prescribe displacements of more nodes or axes"
            )


def _held_motions(mesh: Mesh, supports: Supports, nodes: NDArray[np.int64]) -> Array:
    """Return one row per held unknown: its displacement under the six rigid motions of the part."""
    at = mesh.nodes[nodes] - mesh.nodes[nodes].mean(axis=0)
    at = at / max(float(np.abs(at).max()), 1e-300)
    motions = np.zeros((len(nodes), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for axis in range(3):
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], at)
    rows = [motions[supports.prescribed[nodes]]]
    for axis, tied in supports.tied:
        inside = np.flatnonzero(np.isin(nodes, tied) & ~supports.prescribed[nodes, axis])
        if len(inside) > 1:  # tied nodes can move, but only alike
            rows.append(motions[inside[1:], axis] - motions[inside[0], axis])
    return np.vstack(rows)
