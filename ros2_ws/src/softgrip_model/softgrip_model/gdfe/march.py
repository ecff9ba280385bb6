# SPDX-License-Identifier: Apache-2.0
"""Loads in increments, each started from the extrapolation of those before; halved where no stable end is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.cable import CableDrive
from softgrip_model.gdfe.solver import Equilibrium, Solver, State
from softgrip_model.gdfe.surroundings import Acts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Loading:
    """What acts at one share of the full load."""

    prescribed: Array | None = None
    load: Array | None = None
    drives: tuple[CableDrive, ...] = ()
    acts: Acts | None = None


@dataclass(frozen=True, eq=False)
class March:
    """What a march gives.

    Attributes:
        shares: of the load, of every converged increment.
        equilibria: at these.
        completed: the full load was reached; else the last equilibrium is the last converged one.
        reason: why not.
        iterations: of all increments, including those that failed.
    """

    shares: tuple[float, ...]
    equilibria: tuple[Equilibrium, ...]
    completed: bool
    reason: str
    iterations: int

    @property
    def last(self) -> Equilibrium:
        """The last converged equilibrium."""
        return self.equilibria[-1]


def march(
    solver: Solver,
    loading: Callable[[float], Loading],
    increments: int,
    *,
    tolerance: float = 1e-6,
    length_tolerance: float = 1e-6,
    max_iterations: int = 2000,
    halvings: int = 3,
    first_guess: Array | None = None,
    before: Callable[[Equilibrium | None], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> March:
    """Apply a load in equal increments. An equilibrium that is known not to be stable does not count as one.

    Args:
        solver: to march with.
        loading: what acts at a share 0..1 of the load.
        increments: how many.
        tolerance: of every solve.
        length_tolerance: of every solve.
        max_iterations: of every solve.
        halvings: how often an increment is halved before the march is given up.
        first_guess: (n, 3) displacement at full load that the first increment starts from, scaled; None = rest.
        before: called before every increment with the last converged state, None at rest.
        progress: called with the share of every converged increment.
    """
    known: list[tuple[float, State]] = [(0.0, solver.rest())]
    shares: list[float] = []
    equilibria: list[Equilibrium] = []
    iterations, step, share, halved = 0, 1.0 / increments, 0.0, 0
    reason = ""
    while share < 1.0 - 1e-9:
        target = min(1.0, share + step)
        if before is not None:
            before(equilibria[-1] if equilibria else None)
        act = loading(target)
        found = solver.solve(
            act.prescribed,
            start=_start(known, target, first_guess),
            load=act.load,
            drives=act.drives,
            acts=act.acts,
            since=equilibria[-1] if equilibria else None,
            tolerance=tolerance,
            length_tolerance=length_tolerance,
            max_iterations=max_iterations,
        )
        iterations += found.iterations
        if not found.converged or found.unstable_modes:
            if halved == halvings:
                reason = f"{_fault(found, target)}; kept: {100 * share:.1f} %"
                break
            step, halved = step / 2.0, halved + 1
            continue
        share = target
        known.append((share, found.state))
        shares.append(share)
        equilibria.append(found)
        if progress is not None:
            progress(share)
    if not equilibria:  # nothing converged: what is kept is the mesh at rest
        act = loading(0.0)
        equilibria.append(
            solver.solve(act.prescribed, drives=act.drives, load=act.load, acts=act.acts, max_iterations=0)
        )
        shares.append(0.0)
    return March(tuple(shares), tuple(equilibria), not reason, reason, iterations)


def _fault(found: Equilibrium, target: float) -> str:
    """Return why an equilibrium does not count."""
    where = f"at {100 * target:.1f} % of the load"
    if found.converged:
        return f"no stable equilibrium {where}: {found.unstable_modes} motions lower the energy of the one found"
    return f"no equilibrium {where}: residual {found.residual:.1e} after {found.iterations} iterations"


def _start(known: Sequence[tuple[float, State]], target: float, first_guess: Array | None) -> State:
    """Extrapolate the last two states to the target."""
    share, state = known[-1]
    if len(known) == 1:
        return state if first_guess is None else State(target * first_guess, state.anchor_tension)
    before, earlier = known[-2]
    ahead = (target - share) / (share - before)
    displacement = state.displacement + ahead * (state.displacement - earlier.displacement)
    tension = tuple(
        max(0.0, now + ahead * (now - then))
        for now, then in zip(state.anchor_tension, earlier.anchor_tension, strict=True)
    )
    return State(displacement, tension)
