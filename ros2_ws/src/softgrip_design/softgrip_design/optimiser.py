# SPDX-License-Identifier: Apache-2.0
"""SLSQP from many starts, as in section 4.2.3, with exact gradients; the starts of all fingers share the cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, OptimizeResult, minimize

from softgrip_design.errors import DesignError
from softgrip_design.objective import Objective

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OptimiserSettings:
    """Of the search.

    Attributes:
        starts: per finger, spread over the bounds (Latin hypercube).
        seed: of the starts.
        tolerance: a start ends when a step gains less than this; coarse, as only the best of them go on.
        finalists: so many of the best starts go on,
        final_tolerance: until a step gains less than this.
        iterations: most of one start.
        exact: False = finite differences of the objective instead of its gradient (what the benchmark compares with).
        workers: threads; None = one per core. The kernel works outside Python's lock.
    """

    starts: int = 16
    seed: int = 1
    tolerance: float = 1e-3
    finalists: int = 4
    final_tolerance: float = 1e-8
    iterations: int = 200
    exact: bool = True
    workers: int | None = None


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best of the starts.

    Attributes:
        x: design vector [mm].
        value: objective there.
        start_values: where every start ended, sorted; infinity = it found no equilibrium.
        evaluations: of the objective in all.
    """

    x: Array
    value: float
    start_values: tuple[float, ...]
    evaluations: int


@dataclass
class _Search:
    """Starts of one objective as they come in, and what became of the best of them."""

    objective: Objective
    ended: list[OptimizeResult] = field(default_factory=list)
    finals: list[Future[OptimizeResult]] = field(default_factory=list)

    def best(self, count: int) -> list[OptimizeResult]:
        # ties broken by the design itself: the order in which threads end must not matter
        return sorted(self.ended, key=lambda result: (result.fun, tuple(result.x)))[:count]


def starting_points(lower: Array, upper: Array, starts: int, seed: int) -> Array:
    """Return a Latin hypercube within bounds, (starts, variables): every variable visits every one of its strata."""
    rng = np.random.default_rng(seed)
    strata = rng.permuted(np.tile(np.arange(starts), (len(lower), 1)), axis=1).T
    return np.asarray(lower + (upper - lower) * (strata + rng.random(strata.shape)) / starts)


def optimise(objective: Objective, settings: OptimiserSettings | None = None) -> Optimum:
    """Return the best design of one objective.

    Raises:
        DesignError: no start found a finger with an equilibrium.
    """
    return optimise_all({"": objective}, settings or OptimiserSettings())[""]


def optimise_all(
    objectives: Mapping[str, Objective], settings: OptimiserSettings, advance: Callable[[str], None] = lambda _: None
) -> dict[str, Optimum]:
    """Return the best design of every objective.

    Args:
        objectives: by name.
        settings: of the search.
        advance: called with the objective's name whenever one of its starts has ended.

    Raises:
        DesignError: no start of an objective found a finger with an equilibrium.
    """
    searches = {name: _Search(objective) for name, objective in objectives.items()}
    with ThreadPoolExecutor(settings.workers or os.cpu_count() or 1) as pool:
        pending: dict[Future[OptimizeResult], str] = {}
        for name, search in searches.items():
            objective = search.objective
            for start in starting_points(objective.lower, objective.upper, settings.starts, settings.seed):
                pending[pool.submit(_descend, objective, start, settings, settings.tolerance)] = name
        for done in as_completed(pending):
            searches[pending[done]].ended.append(done.result())
            advance(pending[done])
        for search in searches.values():
            search.finals = [
                pool.submit(_descend, search.objective, start.x, settings, settings.final_tolerance)
                for start in search.best(settings.finalists)
                if np.isfinite(start.fun)
            ]
        return {name: _optimum(name, search) for name, search in searches.items()}


def _optimum(name: str, search: _Search) -> Optimum:
    if not search.finals:
        raise DesignError(
            f"{name}: none of {len(search.ended)} starts gave a finger that closes so far; use more starts, or another "
            "motion or friction"
        )
    finals = [future.result() for future in search.finals]
    best = min([*finals, *search.best(1)], key=lambda result: (result.fun, tuple(result.x)))
    return Optimum(
        x=np.clip(best.x, search.objective.lower, search.objective.upper),
        value=float(best.fun),
        start_values=tuple(sorted(float(result.fun) for result in search.ended)),
        evaluations=sum(int(result.nfev) for result in [*search.ended, *finals]),
    )


def _descend(objective: Objective, start: Array, settings: OptimiserSettings, tolerance: float) -> OptimizeResult:
    function = objective.value_and_gradient if settings.exact else objective.value
    result: OptimizeResult = minimize(  # type: ignore[call-overload]  # its stub wants one-dimensional arrays
        function,
        start,
        jac=True if settings.exact else "2-point",
        method="SLSQP",
        bounds=Bounds(objective.lower, objective.upper),
        options={"ftol": tolerance, "maxiter": settings.iterations},
    )
    return result
