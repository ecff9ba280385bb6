# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pose = Mapping[str, tuple[float, ...]]

#: [m] wrist to knuckle, then three bones; sideways place of the knuckle.
BONES = {
    "index": ((0.090, 0.045, 0.027, 0.023), -0.025),
    "middle": ((0.090, 0.050, 0.030, 0.025), 0.0),
    "ring": ((0.085, 0.047, 0.028, 0.024), 0.020),
    "little": ((0.080, 0.038, 0.020, 0.020), 0.040),
}
FIRST = {"index": 5, "middle": 9, "ring": 13, "little": 17}


def landmarks_of(pose: Pose, thumb_at: str | None = None) -> Array:
    """Landmarks (21, 3) [m] of a hand whose finger joints flex by the given degrees; the thumb's tip lies beside the
    palm, or on a finger's tip."""
    points = np.zeros((21, 3))
    for finger, (bones, sideways) in BONES.items():
        first = FIRST[finger]
        along = np.array([math.sqrt(bones[0] ** 2 - sideways**2), sideways, 0.0]) / bones[0]
        point, heading = bones[0] * along, 0.0
        points[first] = point
        for k, (bone, flexion) in enumerate(zip(bones[1:], pose[finger], strict=True)):
            heading += math.radians(flexion)
            # flexion turns the bone out of the palm's plane, towards -z
            point = point + bone * (math.cos(heading) * along + math.sin(heading) * np.array([0.0, 0.0, -1.0]))
            points[first + 1 + k] = point
    points[1:4] = [[0.02, -0.03, -0.01], [0.04, -0.05, -0.02], [0.05, -0.07, -0.03]]
    points[4] = [0.06, -0.09, -0.04] if thumb_at is None else points[FIRST[thumb_at] + 3] + [0.0, -0.015, 0.0]
    return points


@pytest.fixture
def hand_landmarks() -> Callable[..., Array]:
    return landmarks_of
