# SPDX-License-Identifier: Apache-2.0
"""What a part consists of: outlines with rounded corners, prisms of them, bores with rounded mouths. Lengths in mm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError

Array = NDArray[np.float64]
Point2 = tuple[float, float]
Point3 = tuple[float, float, float]
#: Longest distance of a chord from its arc where an outline is turned into a polygon.
CHORD_ERROR_MM = 0.01


class PartError(DesignError):
    """A part that cannot be made: names the part, the joint and the reason."""


@dataclass(frozen=True)
class Corner:
    """A corner of an outline.

    Attributes:
        x_mm, y_mm: where the straight edges meet.
        radius_mm: of the arc that rounds it.
    """

    x_mm: float
    y_mm: float
    radius_mm: float = 0.0


@dataclass(frozen=True)
class Segment:
    """A piece of an outline: a straight edge, or an arc where `middle` is a point.

    Attributes:
        start, end: (x, y).
        middle: a point of the arc, None for a straight edge.
        radius_mm: of the arc.
    """

    start: Point2
    end: Point2
    middle: Point2 | None = None
    radius_mm: float = 0.0


Outline = tuple[Corner, ...]


@dataclass(frozen=True)
class PartPose:
    """Where a local frame stands.

    Attributes:
        origin: of the frame.
        x_axis, z_axis: unit vectors at a right angle to each other.
    """

    origin: Point3 = (0.0, 0.0, 0.0)
    x_axis: Point3 = (1.0, 0.0, 0.0)
    z_axis: Point3 = (0.0, 0.0, 1.0)

    @property
    def matrix(self) -> Array:
        """The pose, (4, 4)."""
        made = np.eye(4)
        made[:3, 0], made[:3, 2], made[:3, 3] = self.x_axis, self.z_axis, self.origin
        made[:3, 1] = np.cross(self.z_axis, self.x_axis)
        return made


@dataclass(frozen=True)
class Prism:
    """An outline extruded along the local z.

    Attributes:
        outline: counter-clockwise.
        start_mm, end_mm: along z.
        pose: of the local frame in the part.
        holes: outlines that are left out.
    """

    outline: Outline
    start_mm: float
    end_mm: float
    pose: PartPose = PartPose()
    holes: tuple[Outline, ...] = ()


@dataclass(frozen=True)
class Screw:
    """A screw that a hole takes.

    Attributes:
        name: as it is ordered.
        use: what it is for.
        nut: that goes with it; empty: none.
    """

    name: str
    use: str
    nut: str = ""


@dataclass(frozen=True)
class Bore:
    """A round hole between two points, through and a little beyond both where it is open.

    Attributes:
        start, end: on the axis, where it meets the surfaces.
        radius_mm: of the hole.
        mouth_mm: radius with which the edges at start and end are rounded; 0: left sharp.
        beyond_mm: how far the hole is cut past start and end; 0: it ends there.
        screw: to buy for it; None where it takes none, or where the other part's hole counts it.
    """

    start: Point3
    end: Point3
    radius_mm: float
    mouth_mm: tuple[float, float] = (0.0, 0.0)
    beyond_mm: tuple[float, float] = (0.0, 0.0)
    screw: Screw | None = None


@dataclass(frozen=True)
class Form:
    """A part.

    Attributes:
        name: file name of the part.
        title: for people.
        material: of `printing.MATERIALS`.
        bodies: united.
        bores: taken away, their mouths rounded.
        pockets: taken away afterwards.
        letters: engraved last; what is left between their strokes is no wall.
        up: direction of the part that points away from the printer's bed.
        count: how many a hand needs.
        screws: that it takes through something else than a bore.
        is_exchanged: one of several of which one is mounted at a time.
    """

    name: str
    title: str
    material: str
    bodies: tuple[Prism, ...]
    bores: tuple[Bore, ...] = ()
    pockets: tuple[Prism, ...] = ()
    letters: tuple[Prism, ...] = ()
    up: Point3 = (0.0, 0.0, 1.0)
    count: int = 1
    screws: tuple[Screw, ...] = ()
    is_exchanged: bool = False


def corners(*points: Sequence[float]) -> Outline:
    """Return an outline from (x, y) or (x, y, radius) rows."""
    return tuple(Corner(*point) for point in points)


def rectangle(x_mm: tuple[float, float], y_mm: tuple[float, float], radius_mm: float = 0.0) -> Outline:
    """Return an upright rectangle."""
    return corners(*((x, y, radius_mm) for x, y in ((x_mm[0], y_mm[0]), (x_mm[1], y_mm[0]), (x_mm[1], y_mm[1]),
                                                    (x_mm[0], y_mm[1]))))  # fmt: skip


def circle(radius_mm: float, centre: Point2 = (0.0, 0.0)) -> Outline:
    """Return a circle as a square whose corners are rounded by half its side."""
    (x, y), r = centre, radius_mm
    return rectangle((x - r, x + r), (y - r, y + r), r)


def segments(outline: Outline) -> list[Segment]:
    """Return straight edges and arcs of an outline, closed.

    Raises:
        PartError: two roundings need more of an edge than there is.
    """
    points = np.array([(corner.x_mm, corner.y_mm) for corner in outline])
    edges = np.roll(points, -1, axis=0) - points
    lengths = np.hypot(*edges.T)
    cut = [_cut_back(corner.radius_mm, edges[i - 1], edges[i]) for i, corner in enumerate(outline)]
    for i, length in enumerate(lengths):
        needed = cut[i] + cut[(i + 1) % len(cut)]
        if needed > length + 1e-9:
            raise PartError(f"an edge of {length:.3f} mm at {tuple(points[i].round(3))} is too short for its roundings")
    made: list[Segment] = []
    for i, corner in enumerate(outline):
        before, after = edges[i - 1] / lengths[i - 1], edges[i] / lengths[i]
        enter, leave = points[i] - cut[i] * before, points[i] + cut[i] * after
        if cut[i] > 0.0:
            made.append(_arc(enter, leave, points[i], corner.radius_mm))
        following = (i + 1) % len(outline)
        arrive = points[following] - cut[following] * after
        if np.hypot(*(arrive - leave)) > 1e-9:
            made.append(Segment(_point(leave), _point(arrive)))
    return made


def _point(values: Array) -> Point2:
    return float(values[0]), float(values[1])


def _cut_back(radius_mm: float, before: Array, after: Array) -> float:
    """Return how far from its corner an arc begins: r tan(turn / 2)."""
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
    return radius_mm * abs(math.tan(0.5 * turn))


def _arc(enter: Array, leave: Array, corner: Array, radius_mm: float) -> Segment:
    towards = 0.5 * (enter + leave) - corner
    half_chord, depth = 0.5 * float(np.hypot(*(leave - enter))), float(np.hypot(*towards))
    sagitta = radius_mm - math.sqrt(max(radius_mm**2 - half_chord**2, 0.0))
    middle = corner + towards / depth * (depth - sagitta)
    return Segment(_point(enter), _point(leave), _point(middle), radius_mm)


def polygon(outline: Outline) -> Array:
    """Return an outline as points, (n, 2), arcs in chords that leave them by at most CHORD_ERROR_MM."""
    points: list[Point2] = []
    for segment in segments(outline):
        points.append(segment.start)
        if segment.middle is not None:
            points += _chords(segment)
    return np.array(points)


def _chords(segment: Segment) -> list[Point2]:
    start, middle, end = (np.array(p) for p in (segment.start, segment.middle, segment.end))
    half_chord = 0.5 * float(np.hypot(*(end - start)))
    angle = 2.0 * math.asin(min(1.0, half_chord / segment.radius_mm))
    inwards = 0.5 * (start + end) - middle
    centre = middle + inwards / np.hypot(*inwards) * segment.radius_mm
    count = max(2, math.ceil(angle / (2.0 * math.acos(1.0 - CHORD_ERROR_MM / segment.radius_mm))))
    first = math.atan2(*(start - centre)[::-1])
    (ax, ay), (bx, by) = start - centre, end - centre
    sign = math.copysign(1.0, ax * by - ay * bx)
    angles = first + sign * angle * np.arange(1, count) / count
    return [
        (float(x), float(y)) for x, y in centre + segment.radius_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    ]


def area_mm2(outline: Outline) -> float:
    """Return the area within an outline, positive where it runs counter-clockwise."""
    x, y = polygon(outline).T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
