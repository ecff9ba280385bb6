# SPDX-License-Identifier: Apache-2.0
"""Pictures of deformed meshes with matplotlib: the outer surface coloured by strain."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from softgrip_model.gdfe.mesh import HEX_FACES, Mesh

Array = NDArray[np.float64]


def draw_shapes(
    path: Path, mesh: Mesh, shapes: Sequence[tuple[str, Array, Array]], unit: str, reference: Array | None = None
) -> None:
    """Draw deformed shapes side by side, and a reference as black outlines on the last one.

    Args:
        path: png, svg or pdf.
        mesh: at rest.
        shapes: title, displacement (n, 3), strain per element (m,).
        unit: of length.
        reference: displacement (n, 3).
    """
    quads, owner = _surface_with_owner(mesh)
    largest = max(1e-9, *(float(strain.max()) for _, _, strain in shapes))
    colours = mpl.colormaps["viridis"]
    figure = Figure(figsize=(6.0 * len(shapes), 4.5), layout="constrained")
    for number, (title, displacement, strain) in enumerate(shapes):
        axes = figure.add_subplot(1, len(shapes), number + 1, projection="3d")
        points = mesh.nodes + displacement
        faces = Poly3DCollection(points[quads], facecolors=colours(strain[owner] / largest), edgecolor="0.3", lw=0.15)
        axes.add_collection3d(faces)
        if reference is not None and number == len(shapes) - 1:
            outline = (mesh.nodes + reference)[quads]
            axes.add_collection3d(Poly3DCollection(outline, facecolor=(0, 0, 0, 0), edgecolor="black", lw=0.3))
        axes.set_title(f"{title} [{unit}]")
        _scale_axes(axes, points.min(axis=0), points.max(axis=0))
    scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0.0, largest), colours)
    figure.colorbar(scale, ax=figure.axes, location="bottom", shrink=0.6, aspect=30, label="equivalent strain")
    figure.savefig(path, dpi=150)


def _scale_axes(axes: Axes3D, low: Array, high: Array) -> None:
    """Give all axes one scale; a short one carries no ticks, which would lie on top of each other."""
    span = np.maximum(high - low, 1e-9)
    axes.set_box_aspect(span)
    axes.view_init(elev=20.0, azim=-70.0)
    has_room = 4.0 * span.min() > span.max()  # else names lie on ticks
    for name, start, end, length in zip("xyz", low, high, span, strict=True):
        ticks = round(6.0 * length / span.max())
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(ticks) if ticks > 1 else NullLocator())
        axes.set(**{f"{name}lim": (start, end), f"{name}label": name if has_room else ""})


def _surface_with_owner(mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return outer faces (f, 4) and the element each belongs to (f,)."""
    quads = mesh.hexes[:, HEX_FACES].reshape(-1, 4)
    _, first, count = np.unique(np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True)
    outer = np.sort(first[count == 1])
    return quads[outer], outer // len(HEX_FACES)
