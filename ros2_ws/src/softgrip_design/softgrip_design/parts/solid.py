# SPDX-License-Identifier: Apache-2.0
"""Forms as solids, by build123d on Open CASCADE (an extra)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_design.parts.checks import problems_of
from softgrip_design.parts.forms import Bore, Form, Outline, PartError, PartPose, Prism, segments

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

INSTALL = "make parts-setup"
#: Longest distance of a triangle from its surface, and the angle between neighbours [rad], of STL and 3MF.
TOLERANCE_MM, ANGLE_RAD = 0.01, 0.2


@dataclass(frozen=True, eq=False)
class Solid:
    """A part as a solid.

    Attributes:
        form: what it was made of.
        shape: build123d's Solid [mm].
        vertices: (n, 3) [mm] of its surface in triangles.
        triangles: (m, 3) into vertices, normals outwards.
        volume_mm3: of the solid.
    """

    form: Form
    shape: Any
    vertices: Array
    triangles: Triangles
    volume_mm3: float


def cad() -> Any:
    """Return build123d.

    Raises:
        PartError: it is not installed.
    """
    try:
        import build123d  # noqa: PLC0415  an extra
    except ImportError as error:
        raise PartError(f"expected build123d for making solids, found none ({error}); install it: {INSTALL}") from error
    return build123d


def make_solid(form: Form, channels: tuple[Bore, ...] = ()) -> Solid:
    """Return a form as a solid that was checked.

    Args:
        form: the part.
        channels: bores of it that must have a wall of a nozzle's width all around.

    Raises:
        PartError: build123d is missing, or the solid is not what it must be.
    """
    b = cad()
    shape = _united(b, form)
    # mouths are rounded while there are few edges: letters have hundreds
    shape = _rounded_mouths(b, form, _without(form, shape, [_bored(b, bore) for bore in form.bores]))
    shape = _without(form, shape, [_extruded(b, prism) for prism in (*form.pockets, *form.letters)])
    vertices, triangles = triangles_of(shape)
    solid = Solid(form, shape, vertices, triangles, float(shape.volume))
    problems = problems_of(shape, vertices, triangles, channels, form.letters)
    if problems:
        raise PartError("; ".join(f"{form.title}: {text}" for text in problems))
    return solid


def _united(b: Any, form: Form) -> Any:
    first, *others = [_extruded(b, body) for body in form.bodies]
    return first.fuse(*others) if others else first


def _without(form: Form, shape: Any, tools: list[Any]) -> Any:
    solids = (shape.cut(*tools) if tools else shape).solids()
    if len(solids) != 1:
        raise PartError(f"{form.title}: expected one piece, found {len(solids)}; a cut goes right through it")
    return solids[0]


def _plane(b: Any, pose: PartPose) -> Any:
    return b.Plane(origin=pose.origin, x_dir=pose.x_axis, z_dir=pose.z_axis)


def _wire(b: Any, outline: Outline) -> Any:
    edges = [
        b.Edge.make_line(segment.start, segment.end)
        if segment.middle is None
        else b.Edge.make_three_point_arc(segment.start, segment.middle, segment.end)
        for segment in segments(outline)
    ]
    return b.Wire(edges)


def _extruded(b: Any, prism: Prism) -> Any:
    face = b.Face(_wire(b, prism.outline), [_wire(b, hole) for hole in prism.holes])
    body = b.Solid.extrude(face, b.Vector(0.0, 0.0, prism.end_mm - prism.start_mm))
    return body.moved(b.Location(_plane(b, prism.pose)) * b.Location((0.0, 0.0, prism.start_mm)))


def _bored(b: Any, bore: Bore) -> Any:
    start, end = (np.array(point) for point in (bore.start, bore.end))
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    plane = b.Plane(origin=tuple(start - bore.beyond_mm[0] * axis), z_dir=tuple(axis))
    return b.Solid.make_cylinder(bore.radius_mm, length + sum(bore.beyond_mm), plane)


def _rounded_mouths(b: Any, form: Form, shape: Any) -> Any:
    """Round the edges that bores leave where they come out."""
    closed = [(edge, edge.center(b.CenterOf.BOUNDING_BOX)) for edge in shape.edges() if edge.is_closed]
    chosen: dict[float, list[Any]] = {}
    for bore in form.bores:
        for place, radius_mm in zip((bore.start, bore.end), bore.mouth_mm, strict=True):
            if radius_mm <= 0.0:
                continue
            near = [edge for edge, at in closed if (at - b.Vector(*place)).length < 0.5 * bore.radius_mm]
            if len(near) != 1:
                raise PartError(f"{form.title}: the hole at {place[:2]} has no whole mouth; it is cut by a surface")
            chosen.setdefault(radius_mm, []).append(near[0])
    for radius_mm, edges in chosen.items():
        shape = shape.fillet(radius_mm, edges)
    return _without(form, shape, [])


def triangles_of(shape: Any) -> tuple[Array, Triangles]:
    """Return a surface's vertices (n, 3) [mm] and triangles (m, 3), every point once.

    Open CASCADE gives each face points of its own.
    """
    points, triangles = shape.tessellate(TOLERANCE_MM, ANGLE_RAD)
    rounded = np.round(np.array([tuple(point) for point in points]), 6)
    vertices, number = np.unique(rounded, axis=0, return_inverse=True)
    faces = number.reshape(-1)[np.array(triangles)]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, faces[distinct].astype(np.int32)


def write_step(solid: Solid, path: Path) -> None:
    """Write a solid as STEP (AP214) [mm].

    Raises:
        OSError: the file cannot be written.
    """
    if not cad().export_step(solid.shape, path):
        raise OSError(f"{path}: STEP could not be written")
