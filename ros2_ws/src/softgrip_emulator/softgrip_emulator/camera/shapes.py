# SPDX-License-Identifier: Apache-2.0
"""Where a finger's links and markers are in the picture, at one or more instants of an exposure at once.

One pass over all instants: most of the time would go into calls, not into numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.camera.optics import BASE_MARKER_M, MARKER_DIAMETER_M, Optics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_emulator.camera.exposure_sample import Pose

    Array = NDArray[np.float64]

BODY_ABOVE_M: Final = 0.0035
"""The body reaches this far to the other side of the joint line; markers are glued on its flank."""
_CROSS_WIDTH_M: Final = 1e-4
_CROSS_M: Final = 0.5 * _CROSS_WIDTH_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
_RIM_PX: Final = 3


@dataclass(frozen=True)
class Shapes:
    """A finger of n links and what is behind it, at k instants.

    Attributes:
        links_px: (k, n, 6, 2) outlines of the links.
        headings_rad: (k, n) their directions.
        product_px: (m, 2) outline of what is behind the finger; m = 0 for nothing.
        corners_px: (k, n + 2, 2) top left pixel (column, row) of the square round each marker.
        covers: (k, n + 2, s, s) share of each pixel of that square that the marker covers.
    """

    links_px: Array
    headings_rad: Array
    product_px: Array
    corners_px: NDArray[np.int64]
    covers: Array

    def bounds_px(self) -> tuple[Array, Array]:
        """(2,) least and (2,) largest column and row that any of it reaches."""
        squares = self.corners_px.reshape(-1, 2)
        points = np.concatenate(
            [self.links_px.reshape(-1, 2), self.product_px, squares, squares + self.covers.shape[-1]], dtype=np.float64
        )
        return points.min(axis=0), points.max(axis=0)


def shapes_of(poses: list[Pose], optics: Optics, glue_m: Array) -> Shapes:
    """Return what a finger looks like at some instants.

    Args:
        poses: (k,) of one finger; what is behind it is taken from the last.
        optics: of the camera.
        glue_m: (>= n + 2, 2) see `markers_m`.
    """
    joints = np.stack([pose.joints_m for pose in poses])
    headings = np.stack([pose.headings_rad for pose in poses])
    links = _link_outlines(joints, headings, poses[-1].body_height_m)
    # a marker's centre, and the ends of a small cross for the shape of its image
    crosses = markers_m(joints, headings, glue_m)[..., None, :] + _CROSS_M
    product = poses[-1].product_m
    pixels = optics.to_pixels(np.concatenate([links.reshape(-1, 2), crosses.reshape(-1, 2), product]))
    parts = np.split(pixels, [links.size // 2, (links.size + crosses.size) // 2])
    corners, covers = _discs(parts[1].reshape(crosses.shape))
    return Shapes(parts[0].reshape(links.shape), headings, parts[2], corners, covers)


def markers_m(joints_m: Array, headings_rad: Array, glue_m: Array) -> Array:
    """Return (k, n + 2, 2) true centres of the markers in the finger's plane [m]: base, joints, tip.

    Args:
        joints_m: (k, n + 1, 2) joints and tip; (k, 0, 2) when no finger is mounted: the base marker alone.
        headings_rad: (k, n) direction of each link.
        glue_m: (>= n + 2, 2) how far off the joint each marker was glued; turns with the link that carries it.
    """
    count = joints_m.shape[1] + 1
    centres = np.concatenate([np.full((len(joints_m), 1, 2), (-BASE_MARKER_M, 0.0)), joints_m], axis=1)
    carried = np.concatenate([np.zeros((len(joints_m), 2)), headings_rad], axis=1)[:, :count]
    cos, sin, (along, across) = np.cos(carried), np.sin(carried), glue_m[:count].T
    return np.asarray(centres + np.stack([cos * along + sin * across, cos * across - sin * along], axis=-1))


def _link_outlines(joints_m: Array, headings_rad: Array, depth_m: float) -> Array:
    """(k, n, 6, 2) corners of the links' side faces [m]: grooves of 45 degrees open on the closing side."""
    if not headings_rad.size:
        return np.zeros((*headings_rad.shape, 6, 2))
    start, end = joints_m[:, :-1], joints_m[:, 1:]
    cos, sin = np.cos(headings_rad), np.sin(headings_rad)
    along = np.stack([cos, -sin], axis=-1)
    inward = np.stack([-sin, -cos], axis=-1)
    flank = np.minimum(depth_m, 0.45 * np.linalg.norm(end - start, axis=-1))[..., None]
    above = BODY_ABOVE_M * inward
    corners = [start - above, end - above, end, end + flank * (inward - along), start + flank * (inward + along), start]
    return np.stack(corners, axis=2)


def _discs(crosses_px: Array) -> tuple[NDArray[np.int64], Array]:
    """Markers' squares and coverage: distance to the rim, one pixel wide, in the discs' own plane.

    Args:
        crosses_px: (k, n, 5, 2) images of the centres and of `_CROSS_M` round them.
    """
    centres = crosses_px[..., 0, :]
    # how far the picture of a point moves with the point, along x and along y: the columns of the map there
    by_x, by_y = (crosses_px[..., i, :] - crosses_px[..., i + 1, :] for i in (1, 3))
    determinants = by_x[..., 0] * by_y[..., 1] - by_y[..., 0] * by_x[..., 1]
    scales = np.sqrt(np.abs(determinants))
    pixels_per_m = scales / _CROSS_WIDTH_M
    reach = int(np.ceil(0.5 * MARKER_DIAMETER_M * pixels_per_m.max(initial=0.0))) + _RIM_PX
    corners = centres.astype(np.int64) - reach
    places = np.arange(2 * reach + 1) + (corners - centres)[..., None]
    u, v = places[..., 0, None, :], places[..., 1, :, None]
    back = scales / determinants  # pixels to the disc's plane, where a pixel is as long as here
    x = _each(back * by_y[..., 1]) * u - _each(back * by_y[..., 0]) * v
    y = _each(back * by_x[..., 0]) * v - _each(back * by_x[..., 1]) * u
    rim = _each(0.5 * MARKER_DIAMETER_M * pixels_per_m + 0.5)
    return corners, np.clip(rim - np.sqrt(x * x + y * y), 0.0, 1.0)


def _each(values: Array) -> Array:
    """A value for every pixel of a square."""
    return values[..., None, None]
