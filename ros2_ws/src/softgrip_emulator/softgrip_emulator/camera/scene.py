# SPDX-License-Identifier: Apache-2.0
"""The picture: a printed finger with green markers before a workbench, through light, motion, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from softgrip_emulator.camera.shapes import Shapes, markers_m, shapes_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.camera.exposure_sample import Pose
    from softgrip_emulator.camera.optics import Optics

    Array = NDArray[np.float64]
    Image = NDArray[np.uint8]

_BENCH_BGR: Final = (74.0, 70.0, 66.0)
_BODY_BGR: Final = (206, 202, 198)
_BODY_EDGE_BGR: Final = (150, 146, 142)
_PALM_BGR: Final = (112, 108, 106)
_PRODUCT_BGR: Final = (128, 168, 200)
_PRODUCT_EDGE_BGR: Final = (84, 112, 136)
_MARKER_BGR: Final = np.array([62.0, 186.0, 54.0])
_NOISE_BANK: Final = 6
_SUBPIXEL_BITS: Final = 4
_MOTION_STEPS: Final = 3
_MOTION_WORTH_M: Final = 2e-4
"""A finger that moves less in an exposure, a fraction of a pixel, is not smeared."""
_STILL_M: Final = 5e-7
"""A finger that has moved less than this since it was drawn is not drawn again."""
_MARGIN_PX: Final = 6
_WHOLE: Final = (slice(None), slice(None))


@dataclass(frozen=True)
class Light:
    """What the camera's exposure makes of the scene; the neutral value is a well lit bench."""

    gain: float = 1.0
    noise: float = 2.0
    """Standard deviation of the sensor noise [grey levels]."""
    blur_px: float = 0.0
    """Standard deviation of the Gaussian that a lens out of focus adds to its own blur [px]."""

    @property
    def is_neutral(self) -> bool:
        """Whether the picture is what the lens throws on the sensor, but for the noise."""
        return self.gain == 1.0 and self.blur_px == 0.0


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
        self._missing_marker = -1
        self._prepared: _Grain | None = None
        # Markers are glued by hand.
        self._glue_m = self._rng.normal(0.0, 0.15e-3, (16, 2))

    def markers_m(self, pose: Pose) -> Array:
        """(n + 2, 2) true centres of the markers in the finger's plane [m]: base, joints, tip."""
        return np.asarray(markers_m(pose.joints_m[None], pose.headings_rad[None], self._glue_m)[0])

    def prepare(self) -> None:
        """Do what the next frame will need whatever it shows: the bench with its noise. For when nobody waits."""
        if self._prepared is None:
            self._prepared = self._next_grain(self._noise_level)

    def render(
        self, pose: Pose, before: Pose | None = None, light: Light | None = None, missing_marker: int = -1
    ) -> Image:
        """One frame (height, width, 3) BGR.

        Args:
            pose: at the end of the exposure.
            before: at its beginning, for motion blur.
            light: exposure, focus and noise.
            missing_marker: that is not drawn, 0 = at the base; -1 = all are.
        """
        light = light or Light()
        if missing_marker != self._missing_marker:
            self._missing_marker, self._drawn = missing_marker, None
        self._expose(pose, pose if before is None or before.joints_m.shape != pose.joints_m.shape else before)
        if light.noise <= 0.0:
            return np.array(self._in_light(self._soft, light), dtype=np.uint8)
        prepared, self._prepared = self._prepared, None
        if prepared is None or light.noise != self._noise_level:
            prepared = self._next_grain(light.noise)
        if not light.is_neutral:
            return prepared.on(self._in_light(self._soft, light))
        prepared.bench[self._window] = prepared.on(self._soft[self._window], self._window)
        return prepared.bench

    def _in_light(self, image: Image, light: Light) -> Image:
        if light.blur_px > 0.0:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), light.blur_px), dtype=np.uint8)
        return image if light.gain == 1.0 else np.asarray(cv2.convertScaleAbs(image, alpha=light.gain), dtype=np.uint8)

    def _expose(self, pose: Pose, before: Pose) -> None:
        """Bring `_soft` up to date: what the lens throws on the sensor in the time from `before` to `pose`."""
        ends_m = np.concatenate([before.joints_m, pose.joints_m, pose.product_m])
        drawn = self._drawn
        if drawn is not None and drawn.shape == ends_m.shape and np.abs(ends_m - drawn).max(initial=0.0) < _STILL_M:
            return
        self._drawn = ends_m
        moving = np.abs(pose.joints_m - before.joints_m).max(initial=0.0) >= _MOTION_WORTH_M
        shares = np.linspace(1.0, 0.0, _MOTION_STEPS) if moving else [0.0]
        shapes = shapes_of([_between(pose, before, share) for share in shares], self.optics, self._glue_m)
        self._soft[self._window] = self._soft_bench[self._window]
        self._canvas[self._window] = self._bench[self._window]
        self._window = self._window_round(*shapes.bounds_px())
        canvas = self._canvas[self._window]
        total = np.zeros(canvas.shape, np.uint16) if moving else None
        for step in range(len(shares)):
            if step > 0:
                canvas[:] = self._bench[self._window]
            self._draw(shapes, step)
            if total is not None:
                total += canvas
        if total is not None:
            cv2.convertScaleAbs(total, canvas, alpha=1.0 / _MOTION_STEPS)
        # The window's edge shows the bench, which is soft already.
        self._soft[self._window][1:-1, 1:-1] = _soften(canvas)[1:-1, 1:-1]

    def _window_round(self, low_px: Array, high_px: Array) -> tuple[slice, slice]:
        """Rows and columns of the picture round what lies between two corners."""
        size = np.array([self.optics.width, self.optics.height])
        low = np.clip(np.floor(low_px).astype(int) - _MARGIN_PX, 0, size)
        high = np.clip(np.ceil(high_px).astype(int) + _MARGIN_PX, low, size)
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def _draw(self, shapes: Shapes, step: int) -> None:
        """The sharp finger at one instant, on the canvas."""
        if len(shapes.product_px):
            self._fill(_corners(shapes.product_px), _PRODUCT_BGR, _PRODUCT_EDGE_BGR)
        # Light from above: a link that turns down gets darker.
        shades = (0.82 + 0.18 * np.cos(shapes.headings_rad[step])).tolist()
        for outline, shade in zip(_corners(shapes.links_px[step]), shades, strict=True):
            self._fill(outline, [shade * c for c in _BODY_BGR], [shade * c for c in _BODY_EDGE_BGR])
        height, width = self._canvas.shape[:2]
        covers = shapes.covers[step]
        size = covers.shape[-1]
        for number, ((left, top), cover) in enumerate(zip(shapes.corners_px[step].tolist(), covers, strict=True)):
            if number == self._missing_marker or left < 0 or top < 0 or left + size > width or top + size > height:
                continue
            patch = self._canvas[top : top + size, left : left + size]
            patch[:] = np.rint(patch + cover[..., None] * (_MARKER_BGR - patch))

    def _fill(self, corners: NDArray[np.int32], colour: Sequence[float], edge: Sequence[float]) -> None:
        cv2.fillPoly(self._canvas, [corners], tuple(colour), cv2.LINE_AA, _SUBPIXEL_BITS)
        cv2.polylines(self._canvas, [corners], True, tuple(edge), 1, cv2.LINE_AA, _SUBPIXEL_BITS)

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

    def _next_grain(self, level: float) -> _Grain:
        if level != self._noise_level:
            self._noise_level = level
            self._noise_tiles = self._draw_noise(self._again(), level)
        tile = self._noise_tiles[int(self._rng.integers(len(self._noise_tiles)))]
        dv, du = self._rng.integers(0, 64, 2)
        noise = tile[dv : dv + self.optics.height, du : du + self.optics.width]
        return _Grain(noise, self._soft_bench)


class _Grain:
    """The noise of one frame, and the bench with it."""

    def __init__(self, noise: NDArray[np.int8], bench: Image) -> None:
        # apart by sign: OpenCV adds and subtracts bytes three times as fast as it adds them to signed ones
        self._rises = np.maximum(noise, 0).view(np.uint8)
        self._falls = np.maximum(np.negative(noise), 0).view(np.uint8)
        self.bench = self.on(bench)

    def on(self, image: Image, window: tuple[slice, slice] = _WHOLE) -> Image:
        """A part of the picture with its noise."""
        return np.asarray(cv2.subtract(cv2.add(image, self._rises[window]), self._falls[window]), dtype=np.uint8)


def _soften(image: Image) -> Image:
    """The lens' own blur."""
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.65))


def _corners(outlines_px: Array) -> NDArray[np.int32]:
    """Points as OpenCV draws them, with a fraction of a pixel."""
    return np.rint(outlines_px * (1 << _SUBPIXEL_BITS)).astype(np.int32)


def _between(pose: Pose, before: Pose, share: float) -> Pose:
    """The finger this share of the exposure before its end."""
    if share == 0.0:
        return pose
    return replace(
        pose,
        joints_m=pose.joints_m + share * (before.joints_m - pose.joints_m),
        headings_rad=pose.headings_rad + share * (before.headings_rad - pose.headings_rad),
    )
