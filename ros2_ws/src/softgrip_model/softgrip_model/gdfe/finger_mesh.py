# SPDX-License-Identifier: Apache-2.0
"""A finger of a profile as hexahedra: links, V grooves, hinge strips, and where its cable runs. Lengths in mm.

Frame: x along the straight finger, closing towards -y, z across; the joints lie on y = 0, in the middle of their hinge
strips (length l, thickness h). Below a strip the groove: straight walls at +-l/2 down to where the flanks of the
profile's opening are wider, then those flanks. The rigid base in front of the first joint is not meshed: the strip of
joint 0 is clamped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger
from softgrip_model.gdfe.cable import RoutingPoint
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.mesh import Mesh, grid_hexes

Array = NDArray[np.float64]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class Resolution:
    """Elements along each part of a finger."""

    hinge_along: int = 6
    hinge_through: int = 2
    link_along: int = 4
    body_rows: int = 4
    across: int = 4

    def refined(self, factor: int) -> Resolution:
        """Return `factor` times as many elements each way."""
        return Resolution(
            *(
                factor * count
                for count in (self.hinge_along, self.hinge_through, self.link_along, self.body_rows, self.across)
            )
        )


#: By name: about 430 and 2,100 hexahedra for a finger of three joints.
RESOLUTIONS = {"coarse": Resolution(), "fine": Resolution(12, 3, 8, 7, 6)}


@dataclass(frozen=True, eq=False)
class FingerMesh:
    """Mesh, support and cable of one finger.

    Attributes:
        mesh: lengths in mm.
        clamped: nodes held at the base.
        routing: cable points from the base to the anchor at the tip.
        tip: the point at the end of the last link on the line of the apexes.
        link_nodes: per link, nodes of its body.
        sections: (n,) cross-section of each node, as `Solver` takes it; None: counted in elements from the base.
    """

    mesh: Mesh
    clamped: Index
    routing: tuple[RoutingPoint, ...]
    tip: RoutingPoint
    link_nodes: tuple[Index, ...]
    sections: Index | None = None


def mesh_finger(
    finger: Finger, resolution: Resolution | None = None, body_height_mm: float = 12.0, strip_below: float = 0.5
) -> FingerMesh:
    """Return the mesh of a finger.

    Args:
        finger: as the kernel computes it.
        resolution: elements along its parts.
        body_height_mm: depth of the links below the joints.
        strip_below: share of each strip's thickness that lies below its joint; 0.5: the strip bends about the joint as
            the kernel assumes, 0: the joint is the apex of the printed groove.

    Raises:
        GdfeError: links too short for their grooves, body shallower than the routing.
    """
    grid = _Grid(finger, resolution or Resolution(), body_height_mm, strip_below)
    return grid.finger_mesh()


class _Grid:
    """Columns along x, rows from the bottom of the body to the top of the strip; groove cells are left out."""

    def __init__(self, finger: Finger, resolution: Resolution, body_height_mm: float, strip_below: float) -> None:
        self.finger, self.resolution, self.depth = finger, resolution, body_height_mm
        self.strip_below = strip_below
        self.apex = finger.base_mm + np.concatenate([[0.0], np.cumsum(finger.link_mm[:-1])])
        self.end = finger.base_mm + sum(finger.link_mm)
        r = resolution
        self.rows = r.body_rows + r.hinge_through
        # (joint, share) of every column line: even entries strips, odd entries links
        self.columns: list[tuple[str, int, float]] = [("hinge", 0, 0.0)]
        for j in range(finger.joints):
            self.columns += [("hinge", j, t) for t in np.linspace(0.0, 1.0, r.hinge_along + 1)[1:]]
            self.columns += [("link", j, t) for t in np.linspace(0.0, 1.0, r.link_along + 1)[1:]]
        self._check()

    def half_groove(self, joint: int, depth: float) -> float:
        """Half the width of a groove at a depth below its apex."""
        flank = depth * math.tan(0.5 * self.finger.opening_rad[joint])
        return max(0.5 * self.finger.length_mm[joint], flank)

    def link_ends(self, link: int, depth: float) -> tuple[float, float]:
        left = float(self.apex[link]) + self.half_groove(link, depth)
        if link + 1 < self.finger.joints:
            return left, float(self.apex[link + 1]) - self.half_groove(link + 1, depth)
        return left, float(self.end)

    def _check(self) -> None:
        for link in range(self.finger.joints):
            left, right = self.link_ends(link, self.depth)
            if right - left < 0.02 * self.finger.link_mm[link]:
                raise GdfeError(
                    f"link {link}: its grooves meet above the bottom of the body ({self.depth:g} mm deep); "
                    "make the body shallower or the link longer"
                )

    def finger_mesh(self) -> FingerMesh:
        r, finger = self.resolution, self.finger
        across = np.linspace(-0.5 * finger.width_mm, 0.5 * finger.width_mm, r.across + 1)
        plane = np.array(
            [[self.place(column, row) for row in range(self.rows + 1)] for column in range(len(self.columns))]
        )
        nodes = np.concatenate(
            [
                np.repeat(plane[:, :, None, :], r.across + 1, axis=2),
                np.broadcast_to(across[:, None], (*plane.shape[:2], r.across + 1, 1)),
            ],
            axis=3,
        ).reshape(-1, 3)
        shape = (len(self.columns) - 1, self.rows, r.across)
        kept = np.ones(shape, dtype=bool)
        period = r.hinge_along + r.link_along
        hinge = np.arange(shape[0]) % period < r.hinge_along
        kept[hinge, : r.body_rows, :] = False
        hexes = grid_hexes(shape)[kept.ravel()]
        used, renumbered = np.unique(hexes, return_inverse=True)
        mesh = Mesh(nodes[used], renumbered.reshape(-1, 8).astype(np.int32), np.zeros(len(hexes), dtype=np.int32))
        clamped = mesh.nodes_where(mesh.nodes[:, 0] < self.apex[0] - 0.5 * finger.length_mm[0] + 1e-9)
        column_of = np.repeat(np.arange(len(self.columns)), (self.rows + 1) * (r.across + 1))[used]
        return FingerMesh(
            mesh, clamped, self._routing(mesh, column_of), self._tip(mesh, column_of), self._links(mesh, column_of)
        )

    def place(self, column: int, row: int) -> tuple[float, float]:
        """Return x and y of a grid line crossing."""
        r, finger = self.resolution, self.finger
        kind, joint, share = self.columns[column]
        height = finger.thickness_mm[joint]
        if kind == "link":
            height += share * (finger.thickness_mm[min(joint + 1, finger.joints - 1)] - height)
        bottom = -self.strip_below * height
        if row < r.body_rows:
            y = -self.depth + row / r.body_rows * (bottom + self.depth)
            depth = -y
        else:
            y = bottom + (row - r.body_rows) / r.hinge_through * height
            depth = 0.0
        if kind == "hinge" and share not in {0.0, 1.0}:
            return float(self.apex[joint]) + (share - 0.5) * finger.length_mm[joint], y
        if kind == "hinge":
            return float(self.apex[joint]) + math.copysign(self.half_groove(joint, depth), share - 0.5), y
        left, right = self.link_ends(joint, depth)
        return left + share * (right - left), y

    def _line(self, link: int, share_index: int) -> int:
        """Number of the column line at a link's start (0) .. end (link_along)."""
        r = self.resolution
        return link * (r.hinge_along + r.link_along) + r.hinge_along + share_index

    def _tab(self, mesh: Mesh, chosen: NDArray[np.bool_], position: tuple[float, float, float]) -> RoutingPoint:
        """Weights of least norm that reproduce any affine motion of the chosen nodes at the position."""
        nodes = mesh.nodes_where(chosen)
        moments = np.vstack([np.ones(len(nodes)), mesh.nodes[nodes].T])
        weights = np.linalg.lstsq(moments, np.array([1.0, *position]), rcond=None)[0]
        return RoutingPoint(position, nodes, weights)

    def _routing(self, mesh: Mesh, column_of: NDArray[np.int_]) -> tuple[RoutingPoint, ...]:
        finger, points = self.finger, []
        body = mesh.nodes[:, 1] < -0.49 * self.strip_below * min(finger.thickness_mm) + 1e-9
        for joint in range(finger.joints):
            half = 0.5 * finger.opening_rad[joint]
            for side, radius in ((-1.0, finger.routing_mm[2 * joint]), (1.0, finger.routing_mm[2 * joint + 1])):
                depth = radius * math.cos(half)
                if depth > self.depth:
                    raise GdfeError(
                        f"joint {joint}: the cable runs {depth:.2f} mm deep, the body ends at {self.depth:g} mm"
                    )
                position = (float(self.apex[joint]) + side * radius * math.sin(half), -depth, 0.0)
                if side < 0.0 and joint == 0:
                    points.append(RoutingPoint(position, np.zeros(0, dtype=np.int32), np.zeros(0)))
                    continue
                last = self.resolution.link_along
                lines = (
                    [self._line(joint, k) for k in (0, 1)]
                    if side > 0.0
                    else [self._line(joint - 1, k) for k in (last - 1, last)]
                )
                points.append(self._tab(mesh, body & np.isin(column_of, lines), position))
        anchor = (float(self.end), points[-1].position[1], 0.0)
        points.append(self._tab(mesh, body & (column_of >= len(self.columns) - 2), anchor))
        return tuple(points)

    def _tip(self, mesh: Mesh, column_of: NDArray[np.int_]) -> RoutingPoint:
        return self._tab(mesh, column_of >= len(self.columns) - 2, (float(self.end), 0.0, 0.0))

    def _links(self, mesh: Mesh, column_of: NDArray[np.int_]) -> tuple[Index, ...]:
        last = self.resolution.link_along
        return tuple(
            mesh.nodes_where((column_of >= self._line(j, 0)) & (column_of <= self._line(j, last)))
            for j in range(self.finger.joints)
        )
