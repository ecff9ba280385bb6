# SPDX-License-Identifier: Apache-2.0
"""Pair what the camera measured with what was predicted at the same instant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softgrip_demo.record import PairedSample

#: [s] predictions further apart than this are not interpolated between.
LONGEST_GAP = 0.1


@dataclass(frozen=True)
class MeasuredTip:
    """The watched finger in one camera frame: stamp [s], joint angles [rad], tip and its deviation [m]."""

    stamp: float
    angles: tuple[float, ...]
    tip: tuple[float, float]
    tip_stddev: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True)
class Instant:
    """The watched finger as predicted for one tendon state; ``tension`` [N] is the measured one of that state."""

    stamp: float
    pulled_length_m: float
    angles: tuple[float, ...]
    tip: tuple[float, float]
    predicted_tension: float
    tension: float
    tip_stddev: tuple[float, float] = (math.nan, math.nan)


def at_stamp(instants: Sequence[Instant], stamp: float) -> Instant | None:
    """Interpolate predictions at a time [s]; None outside them or in a gap longer than LONGEST_GAP."""
    stamps = [instant.stamp for instant in instants]
    right = int(np.searchsorted(stamps, stamp))
    if right == 0 or right == len(stamps):
        return None
    before, after = instants[right - 1], instants[right]
    if after.stamp - before.stamp > LONGEST_GAP or len(before.angles) != len(after.angles):
        return None
    share = (stamp - before.stamp) / (after.stamp - before.stamp)
    values = (1.0 - share) * _vector(before) + share * _vector(after)
    pulled, predicted_tension, tension, x, y, x_stddev, y_stddev, *angles = (float(v) for v in values)
    return Instant(stamp, pulled, tuple(angles), (x, y), predicted_tension, tension, (x_stddev, y_stddev))


def _vector(instant: Instant) -> np.ndarray:
    forces = (instant.predicted_tension, instant.tension)
    return np.array([instant.pulled_length_m, *forces, *instant.tip, *instant.tip_stddev, *instant.angles])


def pair(measured: Sequence[MeasuredTip], instants: Sequence[Instant]) -> tuple[PairedSample, ...]:
    """Return one sample per camera frame that has a prediction at its own time."""
    ordered = sorted(instants, key=lambda instant: instant.stamp)
    samples = []
    for frame in measured:
        predicted = at_stamp(ordered, frame.stamp)
        if predicted is None or len(predicted.angles) != len(frame.angles):
            continue
        samples.append(
            PairedSample(
                pulled_length_m=predicted.pulled_length_m,
                predicted_angles=predicted.angles,
                measured_angles=frame.angles,
                predicted_tip=predicted.tip,
                measured_tip=frame.tip,
                tension=predicted.tension,
                predicted_tension=predicted.predicted_tension,
                predicted_tip_stddev=predicted.tip_stddev,
                measured_tip_stddev=frame.tip_stddev,
            )
        )
    return tuple(samples)
