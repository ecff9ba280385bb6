# SPDX-License-Identifier: Apache-2.0
"""What happened in a bag, as values: modes, friction fits, closings, grasps, faults. Times in ns since the epoch."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RecordedMode:
    """The cell from a moment on."""

    time: int
    mode: str  # IDLE, GRASPING, ...
    finger_set: str
    product: str
    reason: str


@dataclass(frozen=True)
class RecordedSample:
    """One point of the rig: wrap angle [rad], T1 and T2 [N]."""

    time: int
    angle: float
    tension_high: float
    tension_low: float
    accepted: bool


@dataclass(frozen=True)
class RecordedFit:
    """A friction model in use from a moment on; errors relative."""

    time: int
    id: str
    law: str
    k_reading: str
    coefficients: dict[str, float]
    radius_mm: float
    average_error: float
    maximum_error: float
    r_squared: float
    points: int
    verdict: str


@dataclass(frozen=True)
class RecordedClosing:
    """The free closings of one finger of one profile as the camera saw them, beside their prediction.

    Attributes:
        run: (n,) to which closing a frame belongs, from 0 on.
        pulled: (n,) [m].
        measured, predicted: (n, 2) fingertip [m] in the finger's base frame.
        measured_angles, predicted_angles: (n, joints) [rad] base to tip; NaN where nobody said.
        error_percent: (m,) tip errors of finger/residual [% of the finger's length].
    """

    profile: str
    finger: str
    run: NDArray[np.int64]
    pulled: NDArray[np.float64]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    measured_angles: NDArray[np.float64]
    predicted_angles: NDArray[np.float64]
    error_percent: NDArray[np.float64]


@dataclass(frozen=True)
class RecordedGrasp:
    """One goal of cell/grasp and its end; times in s where not said otherwise; evidence is JSON."""

    time: int
    product: str
    outcome: str
    reason: str
    latency: float
    duration: float
    evidence: str = ""


@dataclass(frozen=True)
class RecordedFault:
    """A fault that appeared."""

    time: int
    source: str
    name: str
    text: str


@dataclass(frozen=True)
class Story:
    """All of it, each in order of time."""

    modes: list[RecordedMode] = field(default_factory=list)
    samples: list[RecordedSample] = field(default_factory=list)
    fits: list[RecordedFit] = field(default_factory=list)
    closings: list[RecordedClosing] = field(default_factory=list)
    grasps: list[RecordedGrasp] = field(default_factory=list)
    faults: list[RecordedFault] = field(default_factory=list)
