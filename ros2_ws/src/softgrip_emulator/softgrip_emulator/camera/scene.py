# SPDX-License-Identifier: Apache-2.0
"""The picture: a printed finger with green markers before a workbench, through light, motion, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from softgrip_emulator.camera.optics import BASE_MARKER_M, MARKER_DIAMETER_M, Optics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Image = NDArray[np.uint8]

_BENCH_BGR: Final = (74.0, 70.0, 66.0)
_BODY_BGR: Final = (206, 202, 198)
_BODY_EDGE_BGR: Final = (150, 146, 142)
_PALM_BGR: Final = (112, 108, 106)
_MARKER_BGR: Final = np.array([62.0, 186.0, 54.0])
_BODY_ABOVE_M: Final = 0.0035
"""The body reaches this far to the other side of the joint line; markers are glued on its flank."""
_NOISE_BANK: Final = 6
_SUBPIXEL_BITS: Final = 4
_MOTION_STEPS: Final = 3
_MOTION_WORTH_PX: Final = 0.7


@dataclass(frozen=True)
class Light:
    """What the camera's exposure makes of the scene; the neutral value is a well lit bench."""

    gain: float = 1.0
    noise: float = 2.0
    """Standard deviation of the sensor noise [grey levels]."""


@dataclass(frozen=True)
class Pose:
    """The finger as the camera sees it at one instant.

    Attributes:
        joints_m: (n + 1, 2) joints and tip in the finger's base frame [m].
        headings_rad: (n,) direction of each link [rad], 0 = straight, growing as it closes.
        body_height_m: depth of the body on the closing side.
    """

    joints_m: Array
    headings_rad: Array
    body_height_m: float = 0.012


class Scene:
    """Renders frames. Not thread-safe: one camera, one scene."""

    def __init__(self, optics: Optics, seed: int) -> None:
        self.optics = optics
        self._rng = np.random.default_rng([seed, 0x5343])
        self._background = self._paint_bench()
        self._noise = [
            self._rng.normal(0.0, 1.0, (optics.height + 64, optics.width + 64, 3)).astype(np.float32)
            for _ in range(_NOISE_BANK)
        ]
        # Kept from frame to frame: fresh pages of memory cost more than drawing into them.
        self._canvas = np.empty_like(self._background)
        self._soft = np.empty_like(self._background)
        self._sum = np.empty(self._background.shape, np.uint16)
        self._noise_level = -1.0
        self._noise_tiles: list[NDArray[np.int8]] = []
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
        image = cv2.GaussianBlur(self._exposed(pose, before), (3, 3), 0.65, dst=self._soft)
        if light.gain != 1.0:
            image = cv2.convertScaleAbs(image, dst=self._canvas, alpha=light.gain)
        if light.noise > 0.0:
            return self._with_noise(image, light.noise)
        return np.array(image, dtype=np.uint8)

    def _exposed(self, pose: Pose, before: Pose | None) -> Image:
        if before is None or before.joints_m.shape != pose.joints_m.shape:
            return self._draw(pose)
        path = self.optics.to_pixels(pose.joints_m) - self.optics.to_pixels(before.joints_m)
        if np.abs(path).max(initial=0.0) < _MOTION_WORTH_PX:
            return self._draw(pose)
        self._sum.fill(0)
        for share in np.linspace(0.0, 1.0, _MOTION_STEPS):
            between = Pose(
                before.joints_m + share * (pose.joints_m - before.joints_m),
                before.headings_rad + share * (pose.headings_rad - before.headings_rad),
                pose.body_height_m,
            )
            cv2.add(self._sum, self._draw(between), dst=self._sum, dtype=cv2.CV_16U)
        return np.asarray(cv2.convertScaleAbs(self._sum, dst=self._canvas, alpha=1.0 / _MOTION_STEPS))

    def _draw(self, pose: Pose) -> Image:
        image = self._canvas
        np.copyto(image, self._background)
        depth = pose.body_height_m
        for (start, end), heading in zip(pairwise(pose.joints_m), pose.headings_rad, strict=True):
            self._polygon(image, _link_outline(start, end, heading, depth), heading)
        for centre in self.markers_m(pose):
            self._disc(image, centre)
        return image

    def _polygon(self, image: Image, outline_m: Array, heading: float) -> None:
        corners = np.rint(self.optics.to_pixels(outline_m) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        # Light from above: a link that turns down gets darker.
        shade = 0.82 + 0.18 * float(np.cos(heading))
        colour = tuple(shade * c for c in _BODY_BGR)
        cv2.fillPoly(image, [corners], colour, cv2.LINE_AA, _SUBPIXEL_BITS)
        edge = tuple(shade * c for c in _BODY_EDGE_BGR)
        cv2.polylines(image, [corners], True, edge, 1, cv2.LINE_AA, _SUBPIXEL_BITS)

    def _disc(self, image: Image, centre_m: Array) -> None:
        """A disc by its coverage of each pixel: distance to the rim, one pixel wide, in the disc's own plane."""
        centre = self.optics.to_pixels(centre_m[None, :])[0]
        jacobian = self.optics.jacobian(centre_m)
        scale = float(np.sqrt(abs(np.linalg.det(jacobian))))
        reach = int(np.ceil(0.5 * MARKER_DIAMETER_M * scale)) + 3
        left, top = int(centre[0]) - reach, int(centre[1]) - reach
        size = 2 * reach + 1
        if left < 0 or top < 0 or left + size > image.shape[1] or top + size > image.shape[0]:
            return
        u, v = np.meshgrid(np.arange(left, left + size) - centre[0], np.arange(top, top + size) - centre[1])
        back = np.linalg.inv(jacobian)
        distance = np.hypot(back[0, 0] * u + back[0, 1] * v, back[1, 0] * u + back[1, 1] * v) * scale
        cover = np.clip(0.5 * MARKER_DIAMETER_M * scale - distance + 0.5, 0.0, 1.0)[:, :, None]
        patch = image[top : top + size, left : left + size]
        patch[:] = np.rint(patch + cover * (_MARKER_BGR - patch)).astype(np.uint8)

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

    def _with_noise(self, image: Image, level: float) -> Image:
        if level != self._noise_level:
            self._noise_level = level
            self._noise_tiles = [np.clip(np.rint(tile * level), -127, 127).astype(np.int8) for tile in self._noise]
        tile = self._noise_tiles[int(self._rng.integers(len(self._noise_tiles)))]
        dv, du = self._rng.integers(0, 64, 2)
        patch = tile[dv : dv + image.shape[0], du : du + image.shape[1]]
        return np.asarray(cv2.add(image, patch, dtype=cv2.CV_8U))


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
