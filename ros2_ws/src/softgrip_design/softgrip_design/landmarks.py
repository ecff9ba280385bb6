# SPDX-License-Identifier: Apache-2.0
"""Joint angles of a hand from its 21 landmarks (MediaPipe Hand Landmarker, world coordinates [m])."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Landmark indices from the wrist (or the thumb's carpometacarpal joint) to the tip, one chain a finger.
CHAINS: dict[str, tuple[int, ...]] = {
    "thumb": (1, 2, 3, 4),
    "index": (0, 5, 6, 7, 8),
    "middle": (0, 9, 10, 11, 12),
    "ring": (0, 13, 14, 15, 16),
    "little": (0, 17, 18, 19, 20),
}


def joint_angles(landmarks: Array, finger: str) -> Array:
    """Return the flexion of each joint of a finger, base to tip.

    The angle of a joint is that between the bones before and after it, so it is never negative; a straight finger has
    some 0.1 to 0.7 rad at the tip joint because landmarks lie on the skin's side of the bones.

    Args:
        landmarks: (frames, 21, 3) [m], NaN where no hand was found.
        finger: one of CHAINS.

    Returns:
        (frames, joints) [rad].
    """
    chain = landmarks[:, CHAINS[finger]]
    bones = np.diff(chain, axis=1)
    directions = bones / np.linalg.norm(bones, axis=2, keepdims=True)
    cosines = np.einsum("fbi,fbi->fb", directions[:, :-1], directions[:, 1:])
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))
