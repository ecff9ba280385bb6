# SPDX-License-Identifier: Apache-2.0
"""Which camera frames belong to a free closing: the open finger is pulled, and nothing else happens to it.

A homing, an opening, a grasp and a torn tendon are no closings: there the prediction answers another question.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

#: [m] a closing begins with the finger as open as this.
MAX_FIRST_PULL_M = 1e-3
#: [m] and goes on at least so far.
MIN_TRAVEL_M = 5e-3
#: [m] a pulled length that falls by no more from frame to frame is noise.
MAX_FALL_M = 1e-4
#: [m] one that grows by less stands.
MIN_STEP_M = 2e-5


@dataclass(frozen=True)
class FingerFrame:
    """One finger as the camera saw it at an instant, beside the prediction of that instant.

    Attributes:
        stamp: [ns].
        pulled_m: pulled length [m].
        measured_tip, predicted_tip: (x, y) [m] in the finger's base frame.
        measured_angles, predicted_angles: [rad] base to tip.
        can_close: no grasp, homing or fault has the finger.
    """

    stamp: int
    pulled_m: float
    measured_tip: tuple[float, float]
    predicted_tip: tuple[float, float]
    measured_angles: tuple[float, ...]
    predicted_angles: tuple[float, ...]
    can_close: bool = True


def free_closings(frames: Sequence[FingerFrame]) -> list[list[FingerFrame]]:
    """Return the frames of each free closing of one finger, those in which it moves.

    Args:
        frames: in the order of their stamps.
    """
    runs: list[list[FingerFrame]] = []
    before: FingerFrame | None = None
    for frame in frames:
        if frame.can_close:
            if before is None or frame.pulled_m < before.pulled_m - MAX_FALL_M:
                runs.append([])
            runs[-1].append(frame)
        before = frame if frame.can_close else None
    return [_moving(run) for run in runs if _is_closing(run)]


def _is_closing(run: Sequence[FingerFrame]) -> bool:
    first, last = run[0].pulled_m, run[-1].pulled_m
    return abs(first) <= MAX_FIRST_PULL_M and last - first >= MIN_TRAVEL_M


def _moving(run: Sequence[FingerFrame]) -> list[FingerFrame]:
    return [frame for before, frame in pairwise(run) if frame.pulled_m >= before.pulled_m + MIN_STEP_M]
