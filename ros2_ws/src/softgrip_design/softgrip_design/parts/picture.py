# SPDX-License-Identifier: Apache-2.0
"""Pictures of parts: triangles seen from afar (no perspective), hidden ones hidden by a depth buffer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Colours (blue, green, red) of the materials, of the background, and where the light comes from, seen by the viewer.
COLOURS = {"tpu": (95, 175, 235), "pla": (200, 190, 180)}
BACKGROUND = 255
LIGHT = np.array([-0.35, 0.55, 0.76])
#: Share of the light that also reaches what is turned away.
AMBIENT = 0.45
#: Drawn so many times as large, then made smaller: smooth edges.
OVERSAMPLING = 2


@dataclass(frozen=True, eq=False)
class PictureBody:
    """Something to draw.

    Attributes:
        vertices: (n, 3) [mm].
        triangles: (m, 3) into vertices.
        colour: blue, green, red.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    colour: tuple[int, int, int]


def viewed_from(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the rotation to a viewer's right, up and towards him, (3, 3); azimuth about z, 0 = from +x."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    towards = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.array([right, np.cross(towards, right), towards])


def draw(bodies: Sequence[PictureBody], view: Array, width_px: int) -> NDArray[np.uint8]:
    """Return a picture of bodies, (height, width, 3), as large as they need."""
    corners = [(body.vertices @ view.T)[body.triangles] for body in bodies]
    everything = np.concatenate(corners).reshape(-1, 3)
    low, high = everything[:, :2].min(axis=0), everything[:, :2].max(axis=0)
    margin = 0.03 * float(high[0] - low[0])
    scale = OVERSAMPLING * width_px / (float(high[0] - low[0]) + 2.0 * margin)
    size = np.ceil((high - low + 2.0 * margin) * scale).astype(int)
    image = np.full((size[1], size[0], 3), BACKGROUND, dtype=np.uint8)
    depth = np.full((size[1], size[0]), -np.inf)
    for body, triangles in zip(bodies, corners, strict=True):
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        seen = normals[:, 2] > 0.0
        normals = normals[seen] / np.linalg.norm(normals[seen], axis=1, keepdims=True)
        light = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
        shades = np.clip(light[:, None] * body.colour, 0, 255).astype(np.uint8)
        placed = triangles[seen]
        placed[:, :, 0] = (placed[:, :, 0] - low[0] + margin) * scale
        placed[:, :, 1] = (high[1] + margin - placed[:, :, 1]) * scale
        for triangle, shade in zip(placed, shades, strict=True):
            _fill(image, depth, triangle, shade)
    smaller = (size[0] // OVERSAMPLING, size[1] // OVERSAMPLING)
    return np.asarray(cv2.resize(image, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _fill(image: NDArray[np.uint8], depth: Array, triangle: Array, shade: NDArray[np.uint8]) -> None:
    """Draw a triangle (3, 3) in pixels and depth wherever nothing nearer is."""
    left, top = np.maximum(np.floor(triangle[:, :2].min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(triangle[:, :2].max(axis=0)).astype(int) + 1, depth.shape[::-1])
    x, y = np.meshgrid(np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5)
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == 0.0:
        return
    u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
    v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    nearness = u * az + v * bz + (1.0 - u - v) * cz
    window = depth[top:bottom, left:right]
    drawn = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (nearness > window)
    window[drawn] = nearness[drawn]
    image[top:bottom, left:right][drawn] = shade


def write(image: NDArray[np.uint8], path: Path) -> None:
    """Write a picture.

    Raises:
        OSError: the file cannot be written.
    """
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path}: the picture could not be written")
