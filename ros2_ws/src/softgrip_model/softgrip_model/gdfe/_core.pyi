# SPDX-License-Identifier: Apache-2.0
# Private core of softgrip_model.gdfe; src/gdfe/binding.cpp.

from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

_Array: TypeAlias = NDArray[np.float64]
_Index: TypeAlias = NDArray[np.int32]

def simd_target() -> str: ...
def simd_targets() -> list[str]: ...
def use_simd_target(name: str) -> None: ...
def read_bandwidth(working_set: int, threads: int, repeats: int) -> float: ...

class Element:
    volume: float
    gradient: _Array
    laplacian: _Array

def make_element(rest: _Array) -> Element: ...
def min_jacobians(rest: _Array, hexes: _Index) -> _Array: ...

class SecantTables:
    def __init__(self, coefficients: _Array, cells: int, end: float, lame_per_mu: Sequence[float]) -> None: ...

class OgdenMaterial:
    def __init__(self, moduli: Sequence[float], exponents: Sequence[float], bulk: float) -> None: ...

class CablePoint:
    def __init__(self, nodes: Sequence[int], weights: Sequence[float], fixed: _Array) -> None: ...

class Cable:
    def __init__(
        self,
        points: Sequence[CablePoint],
        entry: _Array,
        law: int,
        k_reading: int,
        coefficients: Sequence[float],
        radius_mm: float,
    ) -> None: ...

class CableState:
    force: list[_Array]
    slope: list[_Array]
    tension: list[float]
    length: float
    sound: bool

def pull_from_anchor(cable: Cable, points: Sequence[_Array], anchor_tension: float) -> CableState: ...

class FollowerPatch:
    def __init__(self, nodes: Sequence[int], shares: Sequence[float]) -> None: ...

class Obstacle:
    def __init__(
        self, kind: int, point: _Array, axis: _Array, radius: float, friction: float, nodes: Sequence[int]
    ) -> None: ...

class Surroundings:
    def __init__(
        self,
        pressed: Sequence[Sequence[Sequence[int]]],
        followers: Sequence[FollowerPatch],
        obstacles: Sequence[Obstacle],
    ) -> None: ...

class Touch:
    obstacle: int
    node: int
    gap: float
    force: _Array
    sliding: bool

class Law:
    __members__: ClassVar[Mapping[str, Law]]

class VolumeShape:
    __members__: ClassVar[Mapping[str, VolumeShape]]

class Metric:
    __members__: ClassVar[Mapping[str, Metric]]

class Ordering:
    __members__: ClassVar[Mapping[str, Ordering]]

class Method:
    __members__: ClassVar[Mapping[str, Method]]

class Settings:
    def __init__(
        self,
        *,
        law: Law = ...,
        shape: VolumeShape = ...,
        metric: Metric = ...,
        single_precision_factor: bool = ...,
        ordering: Ordering = ...,
        method: Method = ...,
        window: int = ...,
        threads: int = ...,
        step_limit: float = ...,
        sections_after: int = ...,
        max_tangent_unknowns: int = ...,
    ) -> None: ...

class Problem:
    def __init__(
        self,
        *,
        rest: _Array,
        hexes: _Index,
        materials: _Index,
        tables: SecantTables,
        matrix_weight: _Array,
        maps: Sequence[_Index],
        cables: Sequence[Cable] = ...,
        ogden: Sequence[OgdenMaterial] = ...,
        surroundings: Surroundings = ...,
        sections: _Index = ...,
    ) -> None: ...

class CableDrive:
    def __init__(self, *, by_length: bool, target: float) -> None: ...

class Task:
    def __init__(
        self,
        *,
        prescribed: _Array,
        load: _Array,
        drives: Sequence[CableDrive] = ...,
        pressures: Sequence[float] = ...,
        follower_forces: Sequence[Sequence[float]] = ...,
        motions: Sequence[Sequence[float]] = ...,
        motions_before: Sequence[Sequence[float]] = ...,
        before: _Array = ...,
        tolerance: float = ...,
        force_floor: float = ...,
        length_tolerance: float = ...,
        max_iterations: int = ...,
    ) -> None: ...

class Outcome:
    converged: bool
    iterations: int
    residual: float
    length_error: float
    displacement: _Array
    reaction: _Array
    strain: _Array
    anchor_tension: list[float]
    tension: list[list[float]]
    shortening: list[float]
    touches: list[Touch]
    history: list[float]
    unstable_modes: int

class ElementForces:
    def __init__(self, problem: Problem, settings: Settings) -> None: ...
    def at(self, displacement: _Array) -> _Array: ...

class Solver:
    def __init__(self, problem: Problem, settings: Settings) -> None: ...
    def solve(self, task: Task, start: _Array, start_tension: Sequence[float]) -> Outcome: ...
    def set_friction(
        self, cable: int, law: int, k_reading: int, coefficients: Sequence[float], radius_mm: float
    ) -> None: ...
    def energy(self, displacement: _Array) -> float: ...
    def internal_force(self, displacement: _Array) -> _Array: ...
    def strain(self) -> _Array: ...
    def set_thesis_state(self, omega: _Array, last_strain: _Array) -> None: ...
    @property
    def unknowns(self) -> int: ...
    def inverse_nonzeros(self, axis: int) -> int: ...
    def inverse_bytes(self, axis: int) -> int: ...
    @property
    def element_bytes(self) -> int: ...
