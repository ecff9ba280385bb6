# SPDX-License-Identifier: Apache-2.0
"""Forms as solids, by build123d on Open CASCADE (an extra); and what is checked on every solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softgrip_design.parts.forms import Bore, Form, Outline, PartError, PartPose, Prism, segments
from softgrip_design.parts.printing import NOZZLE_MM

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

INSTALL = "make parts-setup"
#: Longest distance of a triangle from its surface, and the angle between neighbours [rad], of STL and 3MF.
TOLERANCE_MM, ANGLE_RAD = 0.01, 0.2
#: How far the volume of the mesh may differ from that of the solid: chords of bores and roundings.
VOLUME_TOLERANCE = 2e-3
#: Chords of a round hole leave it by this much at most; a volume below this one is such a chord's.
CHORD_PLAY_MM, MAX_STRAY_MM3 = 0.03, 0.01


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
    shape = _without(form, shape, [_extruded(b, prism) for prism in form.pockets])
    vertices, triangles = _triangles(shape)
    solid = Solid(form, shape, vertices, triangles, float(shape.volume))
    problems = _problems(solid, channels)
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


def _triangles(shape: Any) -> tuple[Array, Triangles]:
    """Return the surface with every point once; Open CASCADE gives each face points of its own."""
    points, triangles = shape.tessellate(TOLERANCE_MM, ANGLE_RAD)
    rounded = np.round(np.array([tuple(point) for point in points]), 6)
    vertices, number = np.unique(rounded, axis=0, return_inverse=True)
    faces = number.reshape(-1)[np.array(triangles)]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, faces[distinct].astype(np.int32)


def _problems(solid: Solid, channels: tuple[Bore, ...]) -> list[str]:
    """Return what is wrong: Open CASCADE's check of the solid, manifold3d's of its triangles, the channels' walls."""
    import manifold3d as m  # noqa: PLC0415  an extra

    found = []
    if not solid.shape.is_valid:
        found.append("Open CASCADE finds its surface not closed (BRepCheck)")
    elif _cuts_itself(solid.shape):
        found.append("its surface cuts itself (Open CASCADE's BOPAlgo_ArgumentAnalyzer)")
    body = m.Manifold(m.Mesh64(solid.vertices, solid.triangles.astype(np.uint64)))
    if body.status() != m.Error.NoError:
        found.append(f"its triangles are not watertight (manifold3d: {body.status().name})")
    elif abs(body.volume() - solid.volume_mm3) > VOLUME_TOLERANCE * solid.volume_mm3:
        found.append(f"its triangles hold {body.volume():.1f} mm3, the solid {solid.volume_mm3:.1f} mm3")
    else:
        found += [text for bore in channels for text in _channel_problems(m, body, bore)]
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


def write_step(solid: Solid, path: Path) -> None:
    """Write a solid as STEP (AP214) [mm].

    Raises:
        OSError: the file cannot be written.
    """
    if not cad().export_step(solid.shape, path):
        raise OSError(f"{path}: STEP could not be written")
