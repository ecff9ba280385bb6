# SPDX-License-Identifier: Apache-2.0
"""What a finger should do: its joint angles at equal steps of its whole deflection."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError
from softgrip_design.trajectory import FingerTrajectory

Array = NDArray[np.float64]

#: n of Eq 4.4; it is not given in the thesis.
STEPS = 50
#: A finger that deflects less in all has no shape to follow.
MIN_DEFLECTION_RAD = math.radians(15.0)


@dataclass(frozen=True, eq=False)
class DesignTarget:
    """Joint angles over the whole deflection, as Fig 4.5 draws them; time plays no part.

    Attributes:
        deflection_rad: (steps,), sum of the joint angles, growing in equal steps from the first one above zero.
        angle_rad: (steps, joints).
    """

    deflection_rad: Array
    angle_rad: Array

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.angle_rad.shape[1])


def deflection_rad(trajectory: FingerTrajectory, finger: str) -> float:
    """Return how far a finger deflects in all [rad].

    Raises:
        DesignError: the finger is not in the trajectory.
    """
    return float(trajectory.closing(finger)[-1].sum())


def target(trajectory: FingerTrajectory, finger: str, steps: int = STEPS) -> DesignTarget:
    """Return what a finger of the demonstration did.

    Raises:
        DesignError: the finger is not in the trajectory, or hardly moves in it.
    """
    closing = trajectory.closing(finger)
    total = closing.sum(axis=1)
    if total[-1] < MIN_DEFLECTION_RAD:
        raise DesignError(
            f"{finger}: expected a deflection of {math.degrees(MIN_DEFLECTION_RAD):.0f} deg or more, found "
            f"{math.degrees(total[-1]):.1f} deg; choose a motion in which this finger closes"
        )
    requested = total[-1] * np.arange(1, steps + 1) / steps
    angles = np.stack([np.interp(requested, total, joint) for joint in closing.T], axis=1)
    return DesignTarget(requested, angles)
