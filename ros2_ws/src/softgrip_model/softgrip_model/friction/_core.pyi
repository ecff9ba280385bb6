# SPDX-License-Identifier: Apache-2.0
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

TENSION_FLOOR_N: float

def evaluate(
    law: int,
    k_reading: int,
    coefficients: Sequence[float],
    radius_mm: float,
    angle_range: tuple[float, float],
    tension_range: tuple[float, float],
    angle: NDArray[np.float64],
    tension: NDArray[np.float64],
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.uint8],
]: ...
def blow_up_angle(
    law: int, k_reading: int, coefficients: Sequence[float], radius_mm: float, tension: float
) -> float: ...
def fit(
    law: int,
    k_reading: int,
    radius_mm: float,
    angle: NDArray[np.float64],
    tension: NDArray[np.float64],
    ratio: NDArray[np.float64],
    weight: NDArray[np.float64],
    loss: int,
    lower: Sequence[float],
    upper: Sequence[float],
    start: Sequence[float] | None,
) -> tuple[list[float], float, int, bool]: ...
