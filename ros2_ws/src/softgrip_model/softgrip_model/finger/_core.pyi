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
        width_mm: Sequence[float],
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
        joint_model: int,
        body_mm: float,
        poisson: float,
        study: tuple[float, ...],
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

class Contact:
    def __init__(
        self,
        *,
        kind: int,
        index: int,
        along_mm: float,
        limit_rad: float,
        x_mm: float,
        y_mm: float,
        size_mm: float,
    ) -> None: ...

class PathSettings:
    def __init__(
        self, largest_pull_step_mm: float, largest_tension_step_n: float, least_compliance_per_n: float
    ) -> None: ...

class Replication:
    def __init__(
        self,
        passage_radius_mm: float,
        cable_radius_mm: float,
        neighbour_mm: float,
        initial_tension_n: float,
        force: int,
    ) -> None: ...

def follow(
    design: Design,
    friction: Friction,
    targets: Sequence[float],
    control: int,
    contacts: Sequence[Contact],
    settings: PathSettings,
) -> dict[str, Any]: ...
def replicate(
    design: Design, friction: Friction, steps: int, pull_mm: float, recipe: Replication
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]]: ...
def groove(opening: float, angle: float, entry: float, leave: float) -> tuple[float, float, float, float, float]: ...
def bends(design: Design, angle: Sequence[float]) -> list[float]: ...
def strip_moment(design: Design, joint: int, angle: float) -> tuple[float, float, float]: ...
def flexures(design: Design) -> tuple[list[list[list[float]]], list[list[float]], list[float]]: ...

class Fingers:
    def __init__(self, designs: Sequence[Design], frictions: Sequence[Friction]) -> None: ...
    def varied(self, thickness: NDArray[np.float64], routing: NDArray[np.float64]) -> Fingers: ...
    def solve(
        self, targets: NDArray[np.float64], control: int, march: bool, sensitivities: bool, threads: int
    ) -> dict[str, Any]: ...
    @property
    def joints(self) -> int: ...
    def __len__(self) -> int: ...
