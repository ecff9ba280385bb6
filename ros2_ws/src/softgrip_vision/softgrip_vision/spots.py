# SPDX-License-Identifier: Apache-2.0
"""Round spots of a marker's colour: found, measured to a fraction of a pixel, with a standard deviation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

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
#: Every so many background rows and columns tell level and noise well enough.
BACKGROUND_STRIDE = 2
#: So many components have labels of 16 bits.
SHORT_LABELS = 2**16 - 1
#: A component of fewer pixels is a speck.
FEWEST_PIXELS = 4
#: [px] The centre is never better known than this (pixel response, chroma subsampling).
CENTRE_FLOOR_PX = 0.03


class Spot(NamedTuple):
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


class Window(NamedTuple):
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
    image: Image,
    windows: Sequence[Window],
    colour: ColourModel,
    thresholds: Sequence[float],
    area_range_px: tuple[float, float],
) -> list[list[Spot]]:
    """Return the spots in each window of an image, whole ones only (not cut by the window's border).

    Args:
        image: (h, w, 3) BGR.
        windows: (k,) where to look.
        colour: of the markers.
        thresholds: (k,) [grey levels] of the signal, > 0.
        area_range_px: [px^2] smallest and largest area of interest.
    """
    sheet, tops = _sheet(image, windows)
    signal = colour.signal(sheet)
    mask = np.empty(signal.shape, dtype=np.bool_)
    for window, top, threshold in zip(windows, tops, thresholds, strict=True):
        rows = slice(top, top + window.height + 1)
        np.greater(signal[rows], threshold, out=mask[rows])
    labels, boxes = _components(mask)
    found = []
    for window, top in zip(windows, tops, strict=True):
        part = slice(top, top + window.height), slice(0, window.width)
        components = _whole_components(boxes, top, window, area_range_px)
        spots = _measure_all(signal[part], mask[part], labels[part], components) if components else []
        found.append(
            [
                spot._replace(u=window.left + spot.u, v=window.top + spot.v)
                for spot in spots
                if area_range_px[0] <= spot.area_px <= area_range_px[1]
            ]
        )
    return found


def _sheet(image: Image, windows: Sequence[Window]) -> tuple[Image, list[int]]:
    """Return the windows' pixels in one image, one below the other with a black row between, and their top rows.

    One pass over a sheet costs less than one over every window: most of it is calls, not pixels.
    """
    tops, height = [], 0
    for window in windows:
        tops.append(height)
        height += window.height + 1
    sheet: Image = np.zeros((height, max(window.width for window in windows), 3), dtype=np.uint8)
    for window, top in zip(windows, tops, strict=True):
        sheet[top : top + window.height, : window.width] = window.cut(image)
    return sheet, tops


def _components(mask: NDArray[np.bool_]) -> tuple[NDArray[np.integer], list[list[int]]]:
    """Return a mask's components: (h, w) labels from 1 on, and [left, top, width, height, area] of each."""
    # Components stand two pixels apart at least; short labels take half the time where they suffice.
    most = ((len(mask) + 1) // 2) * ((mask.size // len(mask) + 1) // 2)
    kind = cv2.CV_16U if most < SHORT_LABELS else cv2.CV_32S
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8, ltype=kind)
    return labels, stats[1:count].tolist()


def _whole_components(
    boxes: Sequence[Sequence[int]], sheet_top: int, window: Window, area_range_px: tuple[float, float]
) -> list[tuple[int, int, int, int, int, int]]:
    """Return label, left, top, width, height [px] and area [px^2] of a window's components that may be spots.

    Those that its border cuts are left out. Places count from the window's corner.
    """
    smallest, largest = max(FEWEST_PIXELS, 0.5 * area_range_px[0]), 2.0 * area_range_px[1]
    return [
        (index, left, top - sheet_top, width, height, area)
        for index, (left, top, width, height, area) in enumerate(boxes, 1)
        if smallest <= area <= largest
        and sheet_top < top < sheet_top + window.height - height
        and 0 < left < window.width - width
    ]


def _measure_all(
    signal: Signal,
    mask: NDArray[np.bool_],
    labels: NDArray[np.integer],
    components: Sequence[tuple[int, int, int, int, int, int]],
) -> list[Spot]:
    """Return the spots among the components of a window (see _whole_components); places from its corner."""
    background = _level_and_noise(signal, mask)
    spots = []
    for index, left, top, width, height, area in components:
        rows, columns = slice(max(0, top - 2), top + height + 2), slice(max(0, left - 2), left + width + 2)
        spot = _measure(signal[rows, columns], labels[rows, columns], index, area, background)
        if spot is not None:
            spots.append(spot._replace(u=columns.start + spot.u, v=rows.start + spot.v))
    return spots


def _level_and_noise(signal: Signal, mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Return median and robust standard deviation [grey levels] of what lies around the spots."""
    some = slice(None, None, BACKGROUND_STRIDE), slice(None, None, BACKGROUND_STRIDE)
    outside = signal[some][~mask[some]]
    if outside.size < 8:
        return 0.0, ROUNDING_NOISE
    middle = _quantile(outside, 0.5)
    return middle, max(ROUNDING_NOISE, 1.4826 * _quantile(np.abs(outside - middle), 0.5))


def _quantile(values: Signal, share: float) -> float:
    """Return the element below which a share of the values lies, and sort them (a fifth of numpy's percentile)."""
    values.sort()
    return float(values[min(values.size - 1, int(share * values.size))])


def _measure(
    signal: Signal,
    labels: NDArray[np.integer],
    index: int,
    pixels: int,
    background: tuple[float, float],
) -> Spot | None:
    """Return one component as a spot, its place from the corner of its box; None when it does not rise above the noise.

    Args:
        signal: (h, w) of the component's box with a margin.
        labels: (h, w) of the components in it.
        index: label of this one.
        pixels: how many it has.
        background: [grey levels] level and noise around it.
    """
    surroundings, noise = background
    height = _quantile(signal[labels == index], PLATEAU_QUANTILE) - surroundings
    if height <= 3.0 * noise:
        return None
    low, high = RAMP
    slope = 1.0 / ((high - low) * height)
    ramp = (signal - (surroundings + low * height)) * slope
    weight = np.minimum(np.maximum(ramp, 0.0), 1.0)
    edge = (weight > 0.0) & (weight < 1.0)
    if np.count_nonzero(labels) > pixels:
        foreign = ((labels != index) & (labels != 0)).astype(np.uint8)
        weight[cv2.dilate(foreign, np.ones((3, 3), np.uint8)) > 0] = 0.0
    moments = cv2.moments(weight)
    area = moments["m00"]
    if area < 1.0:
        return None
    u, v = moments["m10"] / area, moments["m01"] / area
    spread_u, spread_v, tilt = moments["mu20"] / area, moments["mu02"] / area, moments["mu11"] / area
    mean, half = (spread_u + spread_v) / 2, math.hypot((spread_u - spread_v) / 2, tilt)
    major, minor = mean + half, max(mean - half, 1e-6)
    lever = _second_moment(edge, u, v) / 2 / area**2
    return Spot(
        u=u,
        v=v,
        stddev_px=math.hypot(CENTRE_FLOOR_PX, noise * slope * math.sqrt(CORRELATED_PIXELS * lever)),
        area_px=area,
        roundness=math.sqrt(minor / major),
        solidity=min(1.0, area / (4.0 * math.pi * math.sqrt(major * minor))),
        height=height,
        surroundings=surroundings,
        noise=noise,
    )


def _second_moment(mask: NDArray[np.bool_], u: float, v: float) -> float:
    """Return the sum of the squared distances [px^2] of a mask's pixels from (u, v)."""
    sums = cv2.moments(mask.view(np.uint8))
    squares = sums["m20"] + sums["m02"] - 2.0 * (u * sums["m10"] + v * sums["m01"])
    return max(0.0, float(squares + (u * u + v * v) * sums["m00"]))
