# SPDX-License-Identifier: Apache-2.0
"""Meshes and results in files, through meshio: VTU, VTK, Gmsh, CalculiX/Abaqus input and what else it knows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.mesh import Mesh

Array = NDArray[np.float64]

#: Cell data with the number of each element's material.
MATERIAL = "material"


def read_mesh(path: Path) -> tuple[Mesh, tuple[str, ...]]:
    """Return the hexahedra of a file, and the names of their materials where the file has element sets.

    Materials are numbered by the cell data "material" (from 0), else by element sets in the file's order, else all 0.

    Raises:
        GdfeError: no such file, unknown format, no hexahedra, other elements, a bad mesh.
    """
    try:
        data = meshio.read(path)
    except (OSError, ValueError, KeyError, SystemExit, meshio.ReadError) as error:
        raise GdfeError(f"{path}: cannot be read as a mesh: {error}") from error
    kinds = {block.type for block in data.cells}
    solid = kinds - {"vertex", "line", "quad"}
    if solid != {"hexahedron"}:
        raise GdfeError(f"{path}: expected hexahedra of 8 corners, found {sorted(solid) or 'no volume elements'}")
    chosen = [k for k, block in enumerate(data.cells) if block.type == "hexahedron"]
    hexes = np.vstack([data.cells[k].data for k in chosen])
    names: tuple[str, ...] = ()
    materials = np.zeros(len(hexes), dtype=np.int32)
    if MATERIAL in data.cell_data:
        materials = np.concatenate([data.cell_data[MATERIAL][k] for k in chosen]).astype(np.int32)
    elif data.cell_sets:
        names = tuple(data.cell_sets)
        offsets = np.cumsum([0, *(len(data.cells[k].data) for k in chosen)])
        for number, sets in enumerate(data.cell_sets.values()):
            for offset, k in zip(offsets, chosen, strict=False):
                if sets[k] is not None:
                    materials[offset + np.asarray(sets[k], dtype=np.int64)] = number
    orphans = np.setdiff1d(np.arange(len(data.points)), np.concatenate([block.data.ravel() for block in data.cells]))
    if len(orphans):
        raise GdfeError(f"{path}: node {orphans[0]} belongs to no element ({len(orphans)} such nodes); remove them")
    used, renumbered = np.unique(hexes, return_inverse=True)  # corners of lines and faces only are left out
    return Mesh(data.points[used], renumbered.reshape(-1, 8).astype(np.int32), materials), names


def write_mesh(
    path: Path,
    mesh: Mesh,
    displacement: Array | None = None,
    cell_data: Mapping[str, Array] | None = None,
) -> None:
    """Write a mesh, moved by a displacement (n, 3), with fields on nodes and elements; the format is the suffix."""
    points = mesh.nodes if displacement is None else mesh.nodes + displacement
    # results hardly compress: 40 % smaller for ten times the time
    options = {"compression": None} if path.suffix == ".vtu" else {}
    meshio.Mesh(
        points,
        [("hexahedron", mesh.hexes)],
        point_data={} if displacement is None else {"displacement": displacement},
        cell_data={MATERIAL: [mesh.materials], **{name: [values] for name, values in (cell_data or {}).items()}},
    ).write(path, **options)
