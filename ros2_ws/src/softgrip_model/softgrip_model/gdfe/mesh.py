# SPDX-License-Identifier: Apache-2.0
"""Hexahedral meshes: bars, checks, outer surface. Any consistent unit of length; fingers are in mm."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe import _core
from softgrip_model.gdfe.errors import GdfeError

Array = NDArray[np.float64]
Index = NDArray[np.int32]

#: Corners of the six faces, outward by the right-hand rule, in the corner order of VTK and CalculiX C3D8.
HEX_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]],
    dtype=np.int32,
)
#: (8, 3) places of the corners in the element's own coordinates.
CORNER_SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=np.float64,
)


def shape_slopes(at: Array) -> Array:
    """Return the slopes (8, 3) of the corners' shape functions at a point (3,) in the element's own coordinates."""
    factors = 1.0 + CORNER_SIGNS * at
    others = np.stack([factors[:, [1, 2]], factors[:, [0, 2]], factors[:, [0, 1]]], axis=1).prod(axis=2)
    return np.asarray(CORNER_SIGNS * others / 8.0)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Hexahedra at rest.

    Attributes:
        nodes: (n, 3) positions.
        hexes: (m, 8) node numbers, corners in VTK's order.
        materials: (m,) index of each element's material.
    """

    nodes: Array
    hexes: Index
    materials: Index

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", np.ascontiguousarray(self.nodes, dtype=np.float64))
        object.__setattr__(self, "hexes", np.ascontiguousarray(self.hexes, dtype=np.int32))
        object.__setattr__(self, "materials", np.ascontiguousarray(self.materials, dtype=np.int32))
        _check(self)

    @property
    def digest(self) -> str:
        """Sixteen hex digits of nodes, elements and material numbers."""
        digest = hashlib.sha256()
        for array in (self.nodes, self.hexes, self.materials):
            digest.update(array.tobytes())
        return digest.hexdigest()[:16]

    def surface(self) -> Index:
        """Return the outer faces, (f, 4) node numbers, outward by the right-hand rule."""
        quads = self.hexes[:, HEX_FACES].reshape(-1, 4)
        _, first, count = np.unique(np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True)
        return np.ascontiguousarray(quads[np.sort(first[count == 1])])

    def nodes_where(self, chosen: NDArray[np.bool_]) -> Index:
        """Return the numbers of chosen nodes."""
        return np.flatnonzero(chosen).astype(np.int32)


def _check(mesh: Mesh) -> None:
    nodes, hexes = mesh.nodes, mesh.hexes
    if nodes.ndim != 2 or nodes.shape[1] != 3 or not np.isfinite(nodes).all():
        raise GdfeError(f"mesh: expected finite nodes of shape (n, 3), found {nodes.shape}")
    if hexes.ndim != 2 or hexes.shape[1] != 8 or len(hexes) == 0:
        raise GdfeError(f"mesh: expected at least one hexahedron of 8 corners, found an array of shape {hexes.shape}")
    if mesh.materials.shape != (len(hexes),):
        raise GdfeError(f"mesh: expected one material per element ({len(hexes)}), found {mesh.materials.shape}")
    outside = (hexes < 0) | (hexes >= len(nodes))
    if outside.any():
        element = int(np.flatnonzero(outside.any(axis=1))[0])
        raise GdfeError(f"mesh: element {element} names node {hexes[element].max()}, there are {len(nodes)}")
    ordered = np.sort(hexes, axis=1)
    twice = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if twice.any():
        raise GdfeError(f"mesh: element {int(np.flatnonzero(twice)[0])} uses a node twice (degenerate hexahedron)")
    unused = np.flatnonzero(np.bincount(hexes.ravel(), minlength=len(nodes)) == 0)
    if len(unused):
        raise GdfeError(f"mesh: node {unused[0]} belongs to no element ({len(unused)} such nodes); remove them")
    jacobians = _core.min_jacobians(nodes, hexes)
    size = float(np.ptp(nodes, axis=0).max()) / max(1.0, len(hexes) ** (1.0 / 3.0))
    bad = np.flatnonzero(jacobians <= 1e-9 * size**3)
    if len(bad):
        word = "inverted" if jacobians[bad[0]] < 0 else "degenerate"
        raise GdfeError(
            f"mesh: element {bad[0]} is {word} (least Jacobian {jacobians[bad[0]]:.3g}; {len(bad)} such elements); "
            "order its corners as VTK does and give it volume"
        )


def grid_hexes(shape: tuple[int, int, int]) -> Index:
    """Return the elements of a grid of (nx, ny, nz) cells whose nodes are numbered (i (ny+1) + j)(nz+1) + k."""
    nx, ny, nz = shape
    i, j, k = np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij")
    low = ((i * (ny + 1) + j) * (nz + 1) + k).ravel()
    step_i, step_j = (ny + 1) * (nz + 1), nz + 1
    bottom = np.stack([low, low + step_i, low + step_i + step_j, low + step_j], axis=1)
    hexes: Index = np.concatenate([bottom, bottom + 1], axis=1).astype(np.int32)
    return hexes


def bar(size: tuple[float, float, float], shape: tuple[int, int, int], parts: int = 1) -> Mesh:
    """Return a bar along x, y and z centred, in equal parts along x of materials 0, 1, ...

    Args:
        size: lengths.
        shape: elements along x, y, z.
        parts: number of materials.
    """
    if min(size) <= 0.0 or min(shape) < 1:
        raise GdfeError(f"bar: expected positive lengths and at least one element each way, found {size}, {shape}")
    axes = [np.linspace(0.0, size[0], shape[0] + 1)]
    axes += [np.linspace(-0.5 * size[a], 0.5 * size[a], shape[a] + 1) for a in (1, 2)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ends = np.cumsum((1.0 / parts,) * parts)
    columns = (np.arange(shape[0]) + 0.5) / shape[0]
    material = np.searchsorted(ends, columns).clip(max=len(ends) - 1)
    return Mesh(nodes, grid_hexes(shape), np.repeat(material, shape[1] * shape[2]).astype(np.int32))
