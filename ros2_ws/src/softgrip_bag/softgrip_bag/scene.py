# SPDX-License-Identifier: Apache-2.0
"""What a bag shows over time: fingers in space, pictures, tendons, errors, and what was decided. Times in ns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curve:
    """Numbers over time.

    Attributes:
        path: where it belongs, such as tension/index.
        unit: of the values.
        times_ns: (n,) of the source.
        values: (n,).
    """

    path: str
    unit: str
    times_ns: NDArray[np.int64]
    values: Array


@dataclass(frozen=True, eq=False)
class FingerPosture:
    """A finger at one instant.

    Attributes:
        time_ns: of the source.
        points_m: (joints + 1, 3) from the first joint to the tip [m], in the palm's frame where the bag has one.
    """

    time_ns: int
    points_m: Array


@dataclass(frozen=True)
class SceneEvent:
    """Something that was decided or went wrong; level is INFO, WARN or ERROR."""

    time_ns: int
    level: str
    text: str


@dataclass(frozen=True)
class RecordedScene:
    """All of it.

    Attributes:
        name: of the bag.
        identity: of the bag, the same for the same content.
        images: of the cell's camera, (time, JPEG or PNG).
        poses: (predicted or measured, finger) -> its poses.
        curves: numbers.
        events: in order of time.
    """

    name: str
    identity: str
    images: list[tuple[int, bytes]] = field(default_factory=list)
    poses: dict[tuple[str, str], list[FingerPosture]] = field(default_factory=dict)
    curves: list[Curve] = field(default_factory=list)
    events: list[SceneEvent] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class FingerBase:
    """Where a finger begins.

    Attributes:
        position_m: (3,) of the first joint.
        rotation: (3, 3), its columns are the base's axes.
    """

    position_m: Array
    rotation: Array


def finger_points(
    base: FingerBase, link_lengths_m: Sequence[float], joint_angles_rad: Sequence[float], tip_m: tuple[float, float]
) -> Array:
    """Return joints and tip of a finger in space.

    Links are straight, x along the finger and closing towards -y (docs/conventions.md). The tip is the message's own,
    since flexures bend over their length.

    Args:
        base: of the finger.
        link_lengths_m: (joints,).
        joint_angles_rad: (joints,), growing as the finger closes.
        tip_m: in the base's frame.

    Returns:
        (joints + 1, 3) [m].
    """
    x, y, heading = 0.0, 0.0, 0.0
    plane = [(0.0, 0.0)]
    for length, angle in zip(link_lengths_m[:-1], joint_angles_rad[:-1], strict=True):
        heading -= angle
        x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        plane.append((x, y))
    plane.append(tip_m)
    flat = np.array([(u, v, 0.0) for u, v in plane])
    return np.asarray(base.position_m + flat @ base.rotation.T)
