# SPDX-License-Identifier: Apache-2.0
"""Finding a whole chain of markers in an image when nothing is known about where it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision import _core
from softgrip_vision.calibration import PlaneMap
from softgrip_vision.chain import ChainGeometry
from softgrip_vision.colour import ColourModel, Image, Signal
from softgrip_vision.layout import JOINT_RANGE
from softgrip_vision.spots import Spot, Window, find_spots

Array = NDArray[np.float64]

#: A marker keeps at least so many pixels across in the reduced search image.
SEARCH_DIAMETER_PX = 5.0
#: The search threshold in noise deviations of the reduced image, and its least value [grey levels].
SEARCH_SIGMAS = 6.0
SEARCH_FLOOR = 10.0
#: Multiples of the threshold that are tried.
SEARCH_LEVELS = (1.0, 2.0, 4.0, 8.0)
#: Spots looked at in full resolution at each of them.
MAX_SPOTS = 80
#: Relative area of a marker against the calibrated one.
AREA_RATIO = (0.4, 1.8)
#: A marker's least roundness: a little motion blur is allowed.
MIN_ROUNDNESS = 0.6
#: [m] and relative: how far a distance between two markers may be off (placement, print, blur).
LENGTH_TOLERANCE = (0.8e-3, 0.03)
#: [m] how far the mount may be from where the calibration has it.
MOUNT_TOLERANCE_M = 6e-3


@dataclass(frozen=True)
class FoundChain:
    """A chain that was found.

    Attributes:
        spots: (n + 2) markers, base to tip.
        points: (n + 2, 2) [m] their places in the finger's plane.
        cost: mean squared deviation from the geometry in tolerances; 0 = perfect.
        rival: the cost of the best chain that shares not all spots with this one; inf when there is none.
    """

    spots: tuple[Spot, ...]
    points: Array
    cost: float
    rival: float


def search_threshold(reduced_signal: Signal) -> float:
    """Return the signal level [grey levels] above which a pixel of the reduced image is not background."""
    sample = reduced_signal[::2, ::2]
    middle = float(np.median(sample))
    noise = 1.4826 * float(np.median(np.abs(sample - middle)))
    return max(SEARCH_FLOOR, middle + SEARCH_SIGMAS * noise)


def search_spots(image: Image, region: Window, colour: ColourModel, diameter_px: float) -> list[Spot]:
    """Return spots of about the markers' size anywhere in a region of the image."""
    area = math.pi / 4 * diameter_px**2
    factor = max(1, int(diameter_px / SEARCH_DIAMETER_PX))
    view = region.cut(image)
    size = (max(1, region.width // factor), max(1, region.height // factor))
    reduced = cv2.resize(view, size, interpolation=cv2.INTER_AREA) if factor > 1 else view
    signal = colour.signal(np.asarray(reduced, dtype=np.uint8))
    threshold = search_threshold(signal)
    strongest = float(signal.max())
    spots: list[Spot] = []
    # What touches something green at a low threshold comes apart at a higher one.
    for level in threshold * np.array(SEARCH_LEVELS):
        if level >= strongest:
            break
        for left, top, width, height in _components(signal, level, area / factor**2):
            margin = math.ceil(diameter_px)
            corner = (region.left + left * factor - margin, region.top + top * factor - margin)
            window = _clip(*corner, width * factor, height * factor, margin, image.shape)
            (found,) = find_spots(image, [window], colour, [level], (AREA_RATIO[0] * area, AREA_RATIO[1] * area))
            spots += found
    return _distinct([spot for spot in spots if spot.roundness >= MIN_ROUNDNESS], diameter_px)


def _components(signal: Signal, level: float, area: float) -> list[list[int]]:
    """Return left, top, width, height of what rises above a level, about an area [px^2] large, the nearest first."""
    boxes = _core.components(signal, level)
    areas = boxes[:, 4]
    boxes = boxes[(areas > 0.2 * area) & (areas < 4.0 * area)]
    order = np.argsort(np.abs(np.log(boxes[:, 4] / area)), kind="stable")[:MAX_SPOTS]
    found: list[list[int]] = boxes[order, :4].tolist()
    return found


def _clip(left: int, top: int, width: int, height: int, margin: int, shape: tuple[int, ...]) -> Window:
    right, bottom = min(shape[1], left + width + 2 * margin), min(shape[0], top + height + 2 * margin)
    left, top = max(0, left), max(0, top)
    return Window(left, top, right - left, bottom - top)


def _distinct(spots: Sequence[Spot], diameter_px: float) -> list[Spot]:
    """Return the spots without those that two overlapping windows both saw."""
    kept: list[Spot] = []
    for spot in spots:
        if all(math.hypot(spot.u - other.u, spot.v - other.v) > 0.3 * diameter_px for other in kept):
            kept.append(spot)
    return kept


def find_chain(spots: Sequence[Spot], plane: PlaneMap, geometry: ChainGeometry) -> FoundChain | None:
    """Return the chain among the spots that fits the finger's geometry best; None when none does.

    Depth first from the base; a partial chain is dropped as soon as a distance or an angle is outside its tolerance.
    """
    if len(spots) < geometry.layout.joints + 2:
        return None
    points = plane.to_plane(np.array([(spot.u, spot.v) for spot in spots]))
    complete: list[tuple[float, tuple[int, ...]]] = []
    base_place = np.array([-geometry.base_marker_m, 0.0])
    for base in np.flatnonzero(np.hypot(*(points - base_place).T) < MOUNT_TOLERANCE_M):
        for first in np.flatnonzero(np.hypot(*points.T) < MOUNT_TOLERANCE_M):
            if first == base:
                continue
            cost = _length_cost(points, int(base), int(first), geometry.base_marker_m)
            if cost <= 1.0:
                _extend(points, geometry, (int(base), int(first)), cost, complete)
    if not complete:
        return None
    complete.sort()
    cost, chosen = complete[0]
    rival = complete[1][0] if len(complete) > 1 else math.inf
    return FoundChain(tuple(spots[i] for i in chosen), points[list(chosen)], cost / (len(chosen) - 1), rival)


def _extend(
    points: Array,
    geometry: ChainGeometry,
    chain: tuple[int, ...],
    cost: float,
    complete: list[tuple[float, tuple[int, ...]]],
) -> None:
    link = len(chain) - 2
    if link == geometry.layout.joints:
        complete.append((cost, chain))
        return
    last = points[chain[-1]]
    heading = last - points[chain[-2]]
    for candidate in range(len(points)):
        if candidate in chain:
            continue
        extra = _length_cost(points, chain[-1], candidate, geometry.layout.link_lengths_m[link])
        if extra > 1.0:
            continue
        step = points[candidate] - last
        turn = -math.atan2(heading[0] * step[1] - heading[1] * step[0], float(heading @ step))
        if JOINT_RANGE[0] <= turn <= JOINT_RANGE[1]:
            _extend(points, geometry, (*chain, candidate), cost + extra, complete)


def _length_cost(points: Array, start: int, end: int, length: float) -> float:
    tolerance = LENGTH_TOLERANCE[0] + LENGTH_TOLERANCE[1] * length
    measured = math.hypot(*(points[end] - points[start]))
    return ((measured - length) / tolerance) ** 2
