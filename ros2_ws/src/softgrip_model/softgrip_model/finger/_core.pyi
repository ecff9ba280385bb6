# SPDX-License-Identifier: Apache-2.0
# Private core of softgrip_model.finger; src/finger/binding.cpp.

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_JOINTS: int

class Design:
    def __init__(
        self,
        *,
        base_mm: float,
        width_mm: float,
        link_mm: Sequence[float],
        thickness_mm: Sequence[float],
        length_mm: Sequence[float],
        opening_rad: Sequence[float],
        routing_mm: Sequence[float],
        modulus_mpa: Sequence[float],
        moment_law: int,
        max_strain: float,
        stop_margin_rad: float,
        stop_moment_nmm: float,
        compliance_per_n: float,
        lead_mm: float,
        smoothing_rad: float,
    ) -> None: ...

class Friction:
    def __init__(
        self,
        law: int,
        k_reading: int,
        coefficients: Sequence[float],
        radius_mm: float,
        angle_range: tuple[float, float],
        tension_range: tuple[float, float],
    ) -> None: ...

class Fingers:
    def __init__(self, designs: Sequence[Design], frictions: Sequence[Friction]) -> None: ...
    def varied(self, thickness: NDArray[np.float64], routing: NDArray[np.float64]) -> Fingers: ...
    def solve(
        self, targets: NDArray[np.float64], control: int, march: bool, sensitivities: bool, threads: int
    ) -> dict[str, Any]: ...
    @property
    def joints(self) -> int: ...
    def __len__(self) -> int: ...
