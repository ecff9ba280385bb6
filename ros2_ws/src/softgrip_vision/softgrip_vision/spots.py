# SPDX-License-Identifier: Apache-2.0
"""Round spots of a marker's colour: found, measured to a fraction of a pixel, with a standard deviation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.colour import ColourModel, Image, Signal

#: A spot's edge ramp: weight 0 below this share of its height, 1 above that one. The plateau then counts as flat, so
#: that shading across a marker does not pull the centre.
RAMP = (0.25, 0.65)
#: [grey levels] A signal's noise is at least the rounding of three 8-bit channels.
ROUNDING_NOISE = 0.5
#: Neighbouring pixels share noise (demosaicing, JPEG blocks): as many act as one independent sample.
CORRELATED_PIXELS = 4.0
#: The plateau's signal is this quantile of a spot's pixels (the edge makes up the lower part).
PLATEAU_QUANTILE = 0.75
#: Every so many background pixels tell level and noise well enough.
BACKGROUND_STRIDE = 4
#: [px] The centre is never better known than this (pixel response, chroma subsampling).
CENTRE_FLOOR_PX = 0.03


@dataclass(frozen=True)
class Spot:
    """One spot.

    Attributes:
        u, v: [px] centre, column and row.
        stddev_px: [px] one standard deviation of the centre along each axis.
        area_px: [px^2] area above half height, sub-pixel.
        roundness: 0..1 minor over major axis.
        solidity: 1 for a filled ellipse; less for a ring, a crescent or anything ragged.
        height: [grey levels] signal of its plateau above its surroundings.
        surroundings: [grey levels] signal around it.
        noise: [grey levels] standard deviation of the signal around it.
    """

    u: float
    v: float
    stddev_px: float
    area_px: float
    roundness: float
    solidity: float
    height: float
    surroundings: float
    noise: float


@dataclass(frozen=True)
class Window:
    """A part of an image: left, top, width, height [px], inside the image."""

    left: int
    top: int
    width: int
    height: int

    def cut(self, image: Image) -> Image:
        """Return the view of the image in this window."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def window_around(centre: NDArray[np.float64], half: float, image_size: tuple[int, int]) -> Window | None:
    """Return the square window around (u, v), clipped to the image (width, height); None when nothing is left."""
    width, height = image_size
    left, top = max(0, math.floor(centre[0] - half)), max(0, math.floor(centre[1] - half))
    right, bottom = min(width, math.ceil(centre[0] + half) + 1), min(height, math.ceil(centre[1] + half) + 1)
    if right - left < 3 or bottom - top < 3:
        return None
    return Window(left, top, right - left, bottom - top)


def find_spots(
    image: Image, window: Window, colour: ColourModel, threshold: float, area_range_px: tuple[float, float]
) -> list[Spot]:
    """Return the spots in a window of an image, whole ones only (not cut by the window's border).

    Args:
        image: (h, w, 3) BGR.
        window: where to look.
        colour: of the markers.
        threshold: [grey levels] of the signal.
        area_range_px: [px^2] smallest and largest area of interest.
    """
    signal = colour.signal(window.cut(image))
    mask = (signal > threshold).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if count == 1:
        return []
    surroundings, noise = _level_and_noise(signal[mask == 0][::BACKGROUND_STRIDE])
    spots = []
    smallest = max(4.0, 0.5 * area_range_px[0])
    for index in range(1, count):
        left, top, width, height, area = (int(value) for value in stats[index])
        cut = left == 0 or top == 0 or left + width == window.width or top + height == window.height
        if cut or not smallest <= area <= 2.0 * area_range_px[1]:
            continue
        box = (slice(max(0, top - 2), top + height + 2), slice(max(0, left - 2), left + width + 2))
        spot = _measure(signal[box], labels[box], index, surroundings, noise)
        if spot is not None and area_range_px[0] <= spot.area_px <= area_range_px[1]:
            offset = (window.left + box[1].start, window.top + box[0].start)
            spots.append(_moved(spot, *offset))
    return spots


def _level_and_noise(outside: Signal) -> tuple[float, float]:
    """Return median and robust standard deviation [grey levels] of what lies around the spots."""
    if outside.size < 8:
        return 0.0, ROUNDING_NOISE
    middle = _quantile(outside, 0.5)
    return middle, max(ROUNDING_NOISE, 1.4826 * _quantile(np.abs(outside - middle), 0.5))


def _quantile(values: Signal, share: float) -> float:
    """Return the element below which a share of the values lies (numpy's percentile without its overhead)."""
    at = min(values.size - 1, int(share * values.size))
    return float(np.partition(values, at)[at])


def _measure(signal: Signal, labels: NDArray[np.int32], index: int, surroundings: float, noise: float) -> Spot | None:
    inside = signal[labels == index]
    plateau = _quantile(inside, PLATEAU_QUANTILE)
    height = plateau - surroundings
    if height <= 3.0 * noise:
        return None
    low, high = RAMP
    ramp = (signal - (surroundings + low * height)) * (1.0 / ((high - low) * height))
    weight = np.clip(ramp, 0.0, 1.0)
    foreign = (labels != index) & (labels != 0)
    if foreign.any():
        weight[cv2.dilate(foreign.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = 0.0
    moments = cv2.moments(weight)
    area = moments["m00"]
    if area < 1.0:
        return None
    u, v = moments["m10"] / area, moments["m01"] / area
    spread_u, spread_v, tilt = moments["mu20"] / area, moments["mu02"] / area, moments["mu11"] / area
    mean, half = (spread_u + spread_v) / 2, math.hypot((spread_u - spread_v) / 2, tilt)
    major, minor = mean + half, max(mean - half, 1e-6)
    edge = (ramp > 0.0) & (ramp < 1.0)
    rows, cols = np.nonzero(edge)
    lever = ((cols - u) ** 2 + (rows - v) ** 2).sum() / 2 / area**2
    slope = noise / ((high - low) * height)
    return Spot(
        u=u,
        v=v,
        stddev_px=math.hypot(CENTRE_FLOOR_PX, slope * math.sqrt(CORRELATED_PIXELS * float(lever))),
        area_px=area,
        roundness=math.sqrt(minor / major),
        solidity=min(1.0, area / (4.0 * math.pi * math.sqrt(major * minor))),
        height=height,
        surroundings=surroundings,
        noise=noise,
    )


def _moved(spot: Spot, du: int, dv: int) -> Spot:
    return Spot(
        u=spot.u + du,
        v=spot.v + dv,
        stddev_px=spot.stddev_px,
        area_px=spot.area_px,
        roundness=spot.roundness,
        solidity=spot.solidity,
        height=spot.height,
        surroundings=spot.surroundings,
        noise=spot.noise,
    )
