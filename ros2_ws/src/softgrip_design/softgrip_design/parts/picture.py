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
#: Names: height of their letters, room beside the picture for the longest, least distance between lines, ink.
LETTER_PX, NAME_ROOM_PX, LINE_PX, INK = 12, 165, 22, (60, 60, 60)
#: Drawn so many times as large, then made smaller: smooth edges.
OVERSAMPLING = 2


@dataclass(frozen=True, eq=False)
class PictureBody:
    """Something to draw.

    Attributes:
        vertices: (n, 3) [mm].
        triangles: (m, 3) into vertices.
        colour: blue, green, red.
        name: written beside the picture, with a line to what is seen of it; empty: none.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    colour: tuple[int, int, int]
    name: str = ""


def viewed_from(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the rotation to a viewer's right, up and towards him, (3, 3); azimuth about z, 0 = from +x."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    towards = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.array([right, np.cross(towards, right), towards])


def draw(bodies: Sequence[PictureBody], view: Array, width_px: int) -> NDArray[np.uint8]:
    """Return a picture of bodies, (height, width, 3), as high as they need; names stand beside it, within the width."""
    corners = [(body.vertices @ view.T)[body.triangles] for body in bodies]
    everything = np.concatenate(corners).reshape(-1, 3)
    low, high = everything[:, :2].min(axis=0), everything[:, :2].max(axis=0)
    margin = 0.03 * float(high[0] - low[0])
    room_px = NAME_ROOM_PX if any(body.name for body in bodies) else 0
    scale = OVERSAMPLING * (width_px - 2 * room_px) / (float(high[0] - low[0]) + 2.0 * margin)
    size = np.ceil((high - low + 2.0 * margin) * scale).astype(int)
    image = np.full((size[1], size[0], 3), BACKGROUND, dtype=np.uint8)
    depth = np.full((size[1], size[0]), -np.inf)
    owner = np.full((size[1], size[0]), -1)
    for number, (body, triangles) in enumerate(zip(bodies, corners, strict=True)):
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        seen = normals[:, 2] > 0.0
        normals = normals[seen] / np.linalg.norm(normals[seen], axis=1, keepdims=True)
        light = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
        shades = np.clip(light[:, None] * body.colour, 0, 255).astype(np.uint8)
        placed = triangles[seen]
        placed[:, :, 0] = (placed[:, :, 0] - low[0] + margin) * scale
        placed[:, :, 1] = (high[1] + margin - placed[:, :, 1]) * scale
        before = depth.copy()
        for triangle, shade in zip(placed, shades, strict=True):
            _fill(image, depth, triangle, shade)
        owner[depth > before] = number
    smaller = (size[0] // OVERSAMPLING, size[1] // OVERSAMPLING)
    picture = np.asarray(cv2.resize(image, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    if not room_px:
        return picture
    places = {body.name: _middle(owner == number) for number, body in enumerate(bodies) if body.name}
    return _named(picture, {name: at for name, at in places.items() if at is not None}, room_px)


def _middle(mask: NDArray[np.bool_]) -> Array | None:
    """Return the place (x, y) [px of the picture] in a mask that is nearest to its middle; None for an empty one."""
    rows = np.argwhere(mask)
    if not len(rows):
        return None
    nearest = rows[np.argmin(np.linalg.norm(rows - rows.mean(axis=0), axis=1))]
    return np.asarray(nearest[::-1] / OVERSAMPLING)


def _named(picture: NDArray[np.uint8], places: dict[str, Array], room_px: int) -> NDArray[np.uint8]:
    """Return the picture with names left and right of it and lines to their places (x, y) [px]."""
    height, width = picture.shape[:2]
    image = np.full((height, width + 2 * room_px, 3), BACKGROUND, dtype=np.uint8)
    image[:, room_px : room_px + width] = picture
    for is_left in (True, False):
        names = [name for name, (x, _) in places.items() if bool(x < 0.5 * width) == is_left]
        lines = _spread(sorted((float(places[name][1]), name) for name in names), height)
        for y, name in lines:
            scale = cv2.getFontScaleFromHeight(cv2.FONT_HERSHEY_SIMPLEX, LETTER_PX)
            (text_px, _), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
            x = room_px - text_px - 8 if is_left else room_px + width + 8
            at = (round(places[name][0]) + room_px, round(places[name][1]))
            start = (room_px - 4 if is_left else room_px + width + 4, y)
            cv2.line(image, start, at, INK, 1, cv2.LINE_AA)
            cv2.circle(image, at, 3, INK, -1, cv2.LINE_AA)
            cv2.putText(image, name, (x, y + LETTER_PX // 2), cv2.FONT_HERSHEY_SIMPLEX, scale, INK, 1, cv2.LINE_AA)
    return image


def _spread(heights: Sequence[tuple[float, str]], height: int) -> list[tuple[int, str]]:
    """Return heights of lines near those of their places, none nearer than a line to another or beyond the picture."""
    found: list[tuple[int, str]] = []
    for number, (y, name) in enumerate(heights):
        lowest = height - LINE_PX * (len(heights) - number)
        above = found[-1][0] + LINE_PX if found else LINE_PX
        found.append((round(max(above, min(y, lowest))), name))
    return found


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
