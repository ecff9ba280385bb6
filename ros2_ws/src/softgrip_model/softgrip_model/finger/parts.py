# SPDX-License-Identifier: Apache-2.0
"""The kernel's closed forms one by one, for documents and tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from softgrip_model.finger import _core
from softgrip_model.finger.design import Finger, core_design
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.kernel import Array


@dataclass(frozen=True)
class Groove:
    """The free span of the cable across a joint's groove.

    Attributes:
        span_mm: c.
        arm_mm: moment arm, -dc/dq.
        arm_slope: d arm / dq [mm/rad].
        direction_rad: of the span in the proximal link's frame.
        direction_slope: d direction / dq.
    """

    span_mm: float
    arm_mm: float
    arm_slope: float
    direction_rad: float
    direction_slope: float


def groove(entry_mm: float, exit_mm: float, angle_rad: float, opening_rad: float = np.pi / 2) -> Groove:
    """Return the free span between a routing point at `entry_mm` and one at `exit_mm` from the apex."""
    return Groove(*_core.groove(opening_rad, angle_rad, entry_mm, exit_mm))


def bends(finger: Finger, angle_rad: ArrayLike) -> Array:
    """Return the signed bends of the cable at the routing points [rad], (2 n,), for joint angles [rad], (n,).

    Raises:
        FingerError: not one angle per joint.
    """
    angles = np.asarray(angle_rad, dtype=np.float64).ravel().tolist()
    try:
        return np.array(_core.bends(core_design(finger), angles))
    except ValueError as error:
        raise FingerError(f"{error}; found {len(angles)} for {finger.joints} joints") from error


def strip_moment(finger: Finger, joint: int, angle_rad: float) -> tuple[float, float, float]:
    """Return a strip's bending moment [N mm] and its slopes to the angle [N mm/rad] and to the thickness [N].

    Raises:
        FingerError: no such joint.
    """
    try:
        return _core.strip_moment(core_design(finger), joint, angle_rad)
    except ValueError as error:
        raise FingerError(f"{error}: {joint} of {finger.joints}") from error
