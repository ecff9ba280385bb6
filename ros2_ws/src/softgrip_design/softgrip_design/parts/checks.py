# SPDX-License-Identifier: Apache-2.0
"""What is checked on every solid before it is written: closed, whole, its channels open, its walls printable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_design.parts.forms import Bore, Prism
from softgrip_design.parts.printing import NOZZLE_MM

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

#: How far the volume of the mesh may differ from that of the solid: chords of bores and roundings.
VOLUME_TOLERANCE = 2e-3
#: Chords of a round hole leave it by this much at most; a volume below this one is such a chord's.
CHORD_PLAY_MM, MAX_STRAY_MM3 = 0.03, 0.01
#: Longest edge of the triangles from which walls are measured; smaller ones than this area have no sure normal.
SAMPLE_STEP_MM, MIN_TRIANGLE_MM2 = 1.0, 1e-9
#: A ray begins this deep in the solid; faces within 20 deg of parallel are two sides of a wall.
SKIN_MM, PARALLEL_COSINE = 1e-4, 0.94


def problems_of(
    shape: Any, vertices: Array, triangles: Triangles, channels: tuple[Bore, ...], letters: tuple[Prism, ...]
) -> list[str]:
    """Return what is wrong with a solid; nothing where it can be printed.

    Args:
        shape: build123d's Solid [mm].
        vertices: (n, 3) [mm] of its surface in triangles.
        triangles: (m, 3) into vertices, normals outwards.
        channels: bores of it that must have a wall of a nozzle's width all around.
        letters: engraved; what is left between their strokes is no wall.
    """
    import manifold3d as m  # noqa: PLC0415  an extra

    found = []
    if not shape.is_valid:
        found.append("Open CASCADE finds its surface not closed (BRepCheck)")
    elif _cuts_itself(shape):
        found.append("its surface cuts itself (Open CASCADE's BOPAlgo_ArgumentAnalyzer)")
    body = m.Manifold(m.Mesh64(vertices, triangles.astype(np.uint64)))
    if body.status() != m.Error.NoError:
        found.append(f"its triangles are not watertight (manifold3d: {body.status().name})")
    elif abs(body.volume() - shape.volume) > VOLUME_TOLERANCE * shape.volume:
        found.append(f"its triangles hold {body.volume():.1f} mm3, the solid {shape.volume:.1f} mm3")
    else:
        found += [text for bore in channels for text in _channel_problems(m, body, bore)]
        found += _thickness_problems(body, letters)
    return found


def _cuts_itself(shape: Any) -> bool:
    """Whether faces of a solid cross each other: neither BRepCheck nor manifold3d look for that.

    Args:
        shape: build123d's Solid [mm].
    """
    from OCP.BOPAlgo import BOPAlgo_ArgumentAnalyzer  # noqa: PLC0415  comes with build123d

    analyzer = BOPAlgo_ArgumentAnalyzer()
    analyzer.SetShape1(shape.wrapped)
    analyzer.SelfInterMode = True
    analyzer.Perform()
    return bool(analyzer.HasFaulty())


def _thickness_problems(body: Any, letters: tuple[Prism, ...]) -> list[str]:
    """Return where two faces that lie behind each other leave less than a nozzle's width.

    A ray goes in from the middle of every small triangle of the surface, straight down. What it meets within a nozzle's
    width is the other side of a wall where the two faces are parallel, or nearly so; at an edge they are not.
    """
    mesh = body.refine_to_length(SAMPLE_STEP_MM).to_mesh64()
    a, b, c = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts)].transpose(1, 0, 2)
    normals, middles = np.cross(b - a, c - a), (a + b + c) / 3.0
    sizes = np.linalg.norm(normals, axis=1)
    real = sizes > MIN_TRIANGLE_MM2
    inwards = -normals[real] / sizes[real, None]
    thinnest, place = NOZZLE_MM - CHORD_PLAY_MM, None
    for middle, inward in zip(middles[real], inwards, strict=True):
        hits = body.ray_cast(tuple(middle + SKIN_MM * inward), tuple(middle + thinnest * inward))
        if not hits or float(np.dot(hits[0].normal, inward)) < PARALLEL_COSINE:
            continue
        behind = np.array(hits[0].position)
        if not (_within(letters, middle) and _within(letters, behind)):
            thinnest, place = float(np.linalg.norm(behind - middle)), middle
    if place is None:
        return []
    at = ", ".join(f"{value:.1f}" for value in place)
    return [f"expected walls of at least a nozzle's width ({NOZZLE_MM} mm), found {thinnest:.2f} mm at ({at})"]


def _within(letters: tuple[Prism, ...], point: Array) -> bool:
    """Whether a point lies where letters are engraved: what stands between their strokes carries nothing."""
    for letter in letters:
        x, y, z, _ = np.linalg.inv(letter.pose.matrix) @ (*point, 1.0)
        outline = np.array([(corner.x_mm, corner.y_mm) for corner in letter.outline])
        (left, low), (right, high) = outline.min(axis=0) - NOZZLE_MM, outline.max(axis=0) + NOZZLE_MM
        if left <= x <= right and low <= y <= high and letter.start_mm + SKIN_MM < z < letter.end_mm:
            return True
    return False


def _channel_problems(m: Any, body: Any, bore: Bore) -> list[str]:
    """Return whether a bore is not open, or has less than a nozzle's width around it, away from its mouths."""
    wall = bore.radius_mm + NOZZLE_MM
    # a mouth in an oblique surface begins where the wall's farther side does
    reach = [
        2.0 * mouth + beyond * wall / bore.radius_mm
        for mouth, beyond in zip(bore.mouth_mm, bore.beyond_mm, strict=True)
    ]
    name = f"the channel from {bore.start[:2]} to {bore.end[:2]}"
    found = []
    if (_rod(m, bore, bore.radius_mm - CHORD_PLAY_MM, reach) ^ body).volume() > MAX_STRAY_MM3:
        found.append(f"{name} is not open")
    tube = _rod(m, bore, wall - CHORD_PLAY_MM, reach) - _rod(m, bore, bore.radius_mm + CHORD_PLAY_MM, reach)
    missing = (tube - body).volume()
    if missing > MAX_STRAY_MM3:
        found.append(f"{name}: its wall of {NOZZLE_MM} mm lacks {missing:.3f} mm3; a surface cuts it")
    return found


def _rod(m: Any, bore: Bore, radius_mm: float, reach_mm: Sequence[float]) -> Any:
    """Return a bore's inside up to a radius, shorter at both ends, as a manifold."""
    start, end = (np.array(point) for point in (bore.start, bore.end))
    axis = (end - start) / np.linalg.norm(end - start)
    length = float(np.linalg.norm(end - start)) - sum(reach_mm)
    pose = np.column_stack([*_across(axis), axis, start + reach_mm[0] * axis])
    return m.Manifold.cylinder(length, radius_mm, circular_segments=64).transform(pose)


def _across(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors that make a right-handed frame with an axis."""
    first: Array = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first = first / float(np.linalg.norm(first))
    return first, np.asarray(np.cross(axis, first))
