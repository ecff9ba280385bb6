# SPDX-License-Identifier: Apache-2.0
"""The picture: a printed finger with green markers before a workbench, through light, motion, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from softgrip_emulator.camera.look import Pose
from softgrip_emulator.camera.optics import BASE_MARKER_M, MARKER_DIAMETER_M, Optics

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Image = NDArray[np.uint8]

_BENCH_BGR: Final = (74.0, 70.0, 66.0)
_BODY_BGR: Final = (206, 202, 198)
_BODY_EDGE_BGR: Final = (150, 146, 142)
_PALM_BGR: Final = (112, 108, 106)
_PRODUCT_BGR: Final = (128, 168, 200)
_PRODUCT_EDGE_BGR: Final = (84, 112, 136)
_MARKER_BGR: Final = np.array([62.0, 186.0, 54.0])
_BODY_ABOVE_M: Final = 0.0035
"""The body reaches this far to the other side of the joint line; markers are glued on its flank."""
_NOISE_BANK: Final = 6
_SUBPIXEL_BITS: Final = 4
_MOTION_STEPS: Final = 3
_MOTION_WORTH_PX: Final = 0.7
_STILL_PX: Final = 0.002
"""A finger that has moved less than this since it was drawn is not drawn again."""
_MARGIN_PX: Final = 6
_CROSS_WIDTH_M: Final = 1e-4
_CROSS_M: Final = 0.5 * _CROSS_WIDTH_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


@dataclass(frozen=True)
class Light:
    """What the camera's exposure makes of the scene; the neutral value is a well lit bench."""

    gain: float = 1.0
    noise: float = 2.0
    """Standard deviation of the sensor noise [grey levels]."""


class Scene:
    """Renders frames. Not thread-safe: one camera, one scene."""

    def __init__(self, optics: Optics, seed: int) -> None:
        self.optics = optics
        self._rng = np.random.default_rng([seed, 0x5343])
        self._bench = self._paint_bench()
        # Where the noise begins in the stream of random numbers: at another level it is drawn again, not kept.
        self._noise_begins = self._rng.bit_generator.state
        self._noise_level = Light().noise
        self._noise_tiles = self._draw_noise(self._rng, self._noise_level)
        # Only the window round the finger differs from the bench, and only while the finger moves.
        self._soft_bench = _soften(self._bench)
        self._canvas = self._bench.copy()
        self._soft = self._soft_bench.copy()
        self._window = (slice(0, 0), slice(0, 0))
        self._drawn: Array | None = None
        # Markers are glued by hand.
        self._glue_m = self._rng.normal(0.0, 0.15e-3, (16, 2))

    def markers_m(self, pose: Pose) -> Array:
        """(n + 2, 2) true centres of the markers in the finger's plane [m]: base, joints, tip."""
        base = np.array([[-BASE_MARKER_M, 0.0]])
        centres = np.vstack([base, pose.joints_m])
        # The glue offset turns with the link that carries the marker.
        headings = np.concatenate([[0.0, 0.0], pose.headings_rad])[: len(centres)]
        cos, sin = np.cos(headings), np.sin(headings)
        glue = self._glue_m[: len(centres)]
        turned = np.stack([cos * glue[:, 0] + sin * glue[:, 1], -sin * glue[:, 0] + cos * glue[:, 1]], axis=1)
        return np.asarray(centres + turned)

    def render(self, pose: Pose, before: Pose | None = None, light: Light | None = None) -> Image:
        """One frame (height, width, 3) BGR.

        Args:
            pose: at the end of the exposure.
            before: at its beginning, for motion blur.
            light: exposure and noise.
        """
        light = light or Light()
        self._expose(pose, pose if before is None or before.joints_m.shape != pose.joints_m.shape else before)
        image = self._soft
        if light.gain != 1.0:
            image = cv2.convertScaleAbs(image, alpha=light.gain)
        if light.noise > 0.0:
            return self._with_noise(image, light.noise)
        return np.array(image, dtype=np.uint8)

    def _expose(self, pose: Pose, before: Pose) -> None:
        """Bring `_soft` up to date: what the lens throws on the sensor in the time from `before` to `pose`."""
        product_px = self.optics.to_pixels(pose.product_m)
        joints_px = [self.optics.to_pixels(p.joints_m) for p in (before, pose)]
        ends_px = np.concatenate([*joints_px, product_px])
        drawn = self._drawn
        if drawn is not None and drawn.shape == ends_px.shape and np.allclose(ends_px, drawn, rtol=0.0, atol=_STILL_PX):
            return
        self._drawn = ends_px
        self._soft[self._window] = self._soft_bench[self._window]
        self._canvas[self._window] = self._bench[self._window]
        outlines = [self._outline(p) for p in (before, pose)]
        self._window = self._window_round(np.concatenate([*outlines, product_px]))
        if np.abs(joints_px[1] - joints_px[0]).max(initial=0.0) < _MOTION_WORTH_PX:
            self._draw(pose)
        else:
            total = np.zeros(self._canvas[self._window].shape, np.uint16)
            for share in np.linspace(0.0, 1.0, _MOTION_STEPS):
                between = Pose(
                    before.joints_m + share * (pose.joints_m - before.joints_m),
                    before.headings_rad + share * (pose.headings_rad - before.headings_rad),
                    pose.body_height_m,
                    pose.product_m,
                )
                total += self._draw(between)
            self._canvas[self._window] = cv2.convertScaleAbs(total, alpha=1.0 / _MOTION_STEPS)
        # The window's edge shows the bench, which is soft already.
        self._soft[self._window][1:-1, 1:-1] = _soften(self._canvas[self._window])[1:-1, 1:-1]

    def _outline(self, pose: Pose) -> Array:
        """(n, 2) pixels that contain the finger and its markers."""
        joints = np.vstack([[[-BASE_MARKER_M, 0.0]], pose.joints_m])
        reach = max(pose.body_height_m, MARKER_DIAMETER_M) + _BODY_ABOVE_M
        corners = reach * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
        return self.optics.to_pixels((joints[:, None, :] + corners).reshape(-1, 2))

    def _window_round(self, points_px: Array) -> tuple[slice, slice]:
        """Rows and columns of the picture round some points."""
        size = np.array([self.optics.width, self.optics.height])
        low = np.clip(np.floor(points_px.min(axis=0)).astype(int) - _MARGIN_PX, 0, size)
        high = np.clip(np.ceil(points_px.max(axis=0)).astype(int) + _MARGIN_PX, low, size)
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def _draw(self, pose: Pose) -> Image:
        """The window with the sharp finger."""
        self._canvas[self._window] = self._bench[self._window]
        if len(pose.product_m):
            self._fill(self.optics.to_pixels(pose.product_m), _PRODUCT_BGR, _PRODUCT_EDGE_BGR)
        links = zip(pairwise(pose.joints_m), pose.headings_rad, strict=True)
        outlines = [_link_outline(start, end, heading, pose.body_height_m) for (start, end), heading in links]
        markers = self.markers_m(pose)
        # One call for all points: a marker's centre, and the ends of a small cross for the shape of its image.
        crosses = markers[:, None, :] + _CROSS_M
        points = self.optics.to_pixels(np.concatenate([*outlines, crosses.reshape(-1, 2)]))
        for number, heading in enumerate(pose.headings_rad):
            self._polygon(points[6 * number : 6 * number + 6], heading)
        self._discs(points[6 * len(outlines) :].reshape(-1, 5, 2))
        return self._canvas[self._window]

    def _polygon(self, outline_px: Array, heading: float) -> None:
        # Light from above: a link that turns down gets darker.
        shade = 0.82 + 0.18 * float(np.cos(heading))
        self._fill(outline_px, [shade * c for c in _BODY_BGR], [shade * c for c in _BODY_EDGE_BGR])

    def _fill(self, outline_px: Array, colour: Sequence[float], edge: Sequence[float]) -> None:
        corners = np.rint(outline_px * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        cv2.fillPoly(self._canvas, [corners], tuple(colour), cv2.LINE_AA, _SUBPIXEL_BITS)
        cv2.polylines(self._canvas, [corners], True, tuple(edge), 1, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _discs(self, crosses_px: Array) -> None:
        """Discs by their coverage of each pixel: distance to the rim, one pixel wide, in the discs' own plane.

        Args:
            crosses_px: (n, 5, 2) images of the centres and of `_CROSS_M` round them.
        """
        image = self._canvas
        centres = crosses_px[:, 0]
        jacobians = (crosses_px[:, 1::2] - crosses_px[:, 2::2]).transpose(0, 2, 1) / _CROSS_WIDTH_M
        determinants = jacobians[:, 0, 0] * jacobians[:, 1, 1] - jacobians[:, 0, 1] * jacobians[:, 1, 0]
        scales = np.sqrt(np.abs(determinants))
        back = np.linalg.inv(jacobians) * scales[:, None, None]
        reach = int(np.ceil(0.5 * MARKER_DIAMETER_M * scales.max(initial=0.0))) + 3
        corners = centres.astype(int) - reach
        size = 2 * reach + 1
        steps = np.arange(size)
        u = (steps + (corners - centres)[:, 0, None])[:, None, :]
        v = (steps + (corners - centres)[:, 1, None])[:, :, None]
        across = back[:, 0, 0, None, None] * u + back[:, 0, 1, None, None] * v
        down = back[:, 1, 0, None, None] * u + back[:, 1, 1, None, None] * v
        rim = 0.5 * MARKER_DIAMETER_M * scales[:, None, None] + 0.5
        covers = np.clip(rim - np.sqrt(across * across + down * down), 0.0, 1.0)[..., None]
        for (left, top), cover in zip(corners, covers, strict=True):
            if left < 0 or top < 0 or left + size > image.shape[1] or top + size > image.shape[0]:
                continue
            patch = image[top : top + size, left : left + size]
            patch[:] = np.rint(patch + cover * (_MARKER_BGR - patch))

    def _paint_bench(self) -> Image:
        width, height = self.optics.width, self.optics.height
        image = np.empty((height, width, 3), np.float32)
        image[:] = _BENCH_BGR
        for cells, contrast in ((9, 7.0), (40, 4.0), (160, 2.5)):
            coarse = self._rng.normal(0.0, contrast, (max(2, cells * height // width), cells, 1))
            tint = self._rng.normal(0.0, 0.25 * contrast, (*coarse.shape[:2], 3))
            image += cv2.resize((coarse + tint).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
        palm = np.array([[-0.060, 0.010], [-0.004, 0.010], [-0.004, -0.016], [-0.060, -0.016]])
        corners = np.rint(self.optics.to_pixels(palm)).astype(np.int32)
        cv2.fillPoly(image, [corners], _PALM_BGR, cv2.LINE_AA)
        # A lamp at the upper left.
        u, v = np.meshgrid(np.linspace(-0.4, 1.0, width), np.linspace(-0.3, 1.0, height))
        image *= (1.12 - 0.28 * (u * u + v * v))[:, :, None].astype(np.float32)
        return np.clip(image, 0, 255).astype(np.uint8)

    def _again(self) -> np.random.Generator:
        """The random numbers from where the noise began."""
        random = np.random.default_rng()
        random.bit_generator.state = self._noise_begins
        return random

    def _draw_noise(self, random: np.random.Generator, level: float) -> list[NDArray[np.int8]]:
        """Tiles somewhat larger than a frame; a frame gets a random part of one of them."""
        tiles = np.empty((_NOISE_BANK, self.optics.height + 64, self.optics.width + 64, 3), np.int8)
        for tile in tiles:
            for row in tile:
                draw = random.normal(0.0, 1.0, row.shape).astype(np.float32)
                row[:] = np.clip(np.rint(draw * level), -127, 127)
        return list(tiles)

    def _with_noise(self, image: Image, level: float) -> Image:
        if level != self._noise_level:
            self._noise_level = level
            self._noise_tiles = self._draw_noise(self._again(), level)
        tile = self._noise_tiles[int(self._rng.integers(len(self._noise_tiles)))]
        dv, du = self._rng.integers(0, 64, 2)
        patch = tile[dv : dv + image.shape[0], du : du + image.shape[1]]
        return np.asarray(cv2.add(image, patch, dtype=cv2.CV_8U))


def _soften(image: Image) -> Image:
    """The lens' own blur."""
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.65))


def _link_outline(start: Array, end: Array, heading: float, depth_m: float) -> Array:
    """Corners of one link's side face [m]: grooves of 45 degrees open on the closing side."""
    along = np.array([np.cos(heading), -np.sin(heading)])
    inward = np.array([-np.sin(heading), -np.cos(heading)])
    length = float(np.linalg.norm(end - start))
    flank = min(depth_m, 0.45 * length)
    return np.stack(
        [
            start - _BODY_ABOVE_M * inward,
            end - _BODY_ABOVE_M * inward,
            end,
            end - flank * along + flank * inward,
            start + flank * along + flank * inward,
            start,
        ]
    )
