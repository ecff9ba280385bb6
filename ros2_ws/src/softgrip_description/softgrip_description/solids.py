# SPDX-License-Identifier: Apache-2.0
"""The body of each link as a prism: outline in the finger's plane, extruded over its width; written as binary STL.

A link runs from its joint to the next one. Its body hangs below the joints' line (y = 0) to the body's height. At each
end the flank of the V groove cuts it back (thesis Fig 3.5). The printed part has strips and cable channels besides; for
showing a finger and for collisions the prism is enough.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray

from softgrip_model.profile import FingerDesign

Array = NDArray[np.float64]

#: [m] how far the body stands above the joints' line: half of the thickest strip that a profile may have
_TOP_M = 0.002


def link_outline(design: FingerDesign, link: int) -> Array:
    """Return a link's outline in its own frame, counter-clockwise, (4, 2) [m].

    Args:
        design: the finger.
        link: 0 is the one after the first joint.
    """
    depth = design.body_height_m
    length = design.link_lengths_m[link]
    near = depth * math.tan(0.5 * design.openings_rad[link])
    last = link + 1 == design.joints
    far = 0.0 if last else depth * math.tan(0.5 * design.openings_rad[link + 1])
    # Flanks may meet above the body's height. The finger mesh refuses such a profile, a picture need not.
    if near + far > 0.95 * length:
        scale = 0.95 * length / (near + far)
        near, far = near * scale, far * scale
    return np.array([(near, -depth), (length - far, -depth), (length, _TOP_M), (0.0, _TOP_M)])


def base_outline(design: FingerDesign) -> Array:
    """Return the outline of the rigid part before joint 0, counter-clockwise, (4, 2) [m]; (0, 2) without one."""
    if design.base_length_m <= 0.0:
        return np.zeros((0, 2))
    length, depth = design.base_length_m, design.body_height_m
    near = min(depth * math.tan(0.5 * design.openings_rad[0]), 0.95 * length)
    return np.array([(-length, -depth), (-near, -depth), (0.0, _TOP_M), (-length, _TOP_M)])


def area_and_centroid(outline: Array) -> tuple[float, Array]:
    """Return a polygon's area [m2] and centroid, (2,) [m]; the shoelace formula."""
    x, y = outline.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = 0.5 * float(cross.sum())
    centroid = np.array([
        ((x + np.roll(x, -1)) * cross).sum(),
        ((y + np.roll(y, -1)) * cross).sum(),
    ]) / (6.0 * area)  # fmt: skip
    return area, centroid


def prism_inertia(outline: Array, width_m: float, density_kg_m3: float) -> tuple[float, Array, Array]:
    """Return mass [kg], centre (3,) [m] and inertia about the centre (3, 3) [kg m2] of an extruded outline.

    The second moments of a polygon are sums over its edges (Steger, "On the calculation of arbitrary moments of
    polygons", 1996).
    """
    area, (cx, cy) = area_and_centroid(outline)
    x, y = (outline - (cx, cy)).T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y2 - x2 * y
    second_x = float((cross * (x * x + x * x2 + x2 * x2)).sum()) / 12.0  # of x^2
    second_y = float((cross * (y * y + y * y2 + y2 * y2)).sum()) / 12.0
    mixed = float((cross * (x * y2 + 2.0 * x * y + 2.0 * x2 * y2 + x2 * y)).sum()) / 24.0
    mass = density_kg_m3 * area * width_m
    across = mass * width_m**2 / 12.0
    per_area = density_kg_m3 * width_m
    inertia = np.array([
        [per_area * second_y + across, -per_area * mixed, 0.0],
        [-per_area * mixed, per_area * second_x + across, 0.0],
        [0.0, 0.0, per_area * (second_x + second_y)],
    ])  # fmt: skip
    return mass, np.array([cx, cy, 0.0]), inertia


def prism_triangles(outline: Array, width_m: float) -> Array:
    """Return the surface of a convex outline extruded over +-width/2 along z, (4 n - 4, 3, 3) [m], normals outwards."""
    n = len(outline)
    top = np.column_stack([outline, np.full(n, 0.5 * width_m)])
    bottom = np.column_stack([outline, np.full(n, -0.5 * width_m)])
    triangles = [(top[0], top[i], top[i + 1]) for i in range(1, n - 1)]
    triangles += [(bottom[0], bottom[i + 1], bottom[i]) for i in range(1, n - 1)]
    for i in range(n):
        j = (i + 1) % n
        triangles += [(bottom[i], bottom[j], top[j]), (bottom[i], top[j], top[i])]
    return np.array(triangles)


def stl_of(triangles: Array) -> bytes:
    """Return triangles (k, 3, 3) [m] as binary STL."""
    edges = triangles[:, 1:] - triangles[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(triangles), dtype=[("numbers", "<f4", (4, 3)), ("attribute", "<u2")])
    records["numbers"][:, 0], records["numbers"][:, 1:] = normals, triangles
    return b"softgrip link".ljust(80, b"\0") + struct.pack("<I", len(triangles)) + records.tobytes()
