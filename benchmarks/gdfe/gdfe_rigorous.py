# SPDX-License-Identifier: Apache-2.0
"""What the rigorous law's own tangent saves at nu = 0.49: a drawn bar, and fingers that a cable closes.

Table 5.2's bar drawn to twice its length: 1,250 hexahedra of two materials, ten increments, one thread; the constant
matrix alone with the window and the bounded steps that suit it.

The three shipped fingers, 432 hexahedra of NinjaFlex: the keyframes of a closing to 12 mm, each extrapolated from those
before. The pinch finger pulled a millimetre at a time to 3 mm, each length from the one before as it stands. Beside it
constant matrix and cross-sections alone. All in the same run.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe import ConstitutiveLaw, Solver, SolverSettings
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings, solve_closing
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.march import March, march
from softgrip_model.gdfe.materials import ninjaflex_ogden
from softgrip_model.gdfe.solver import Equilibrium, State
from softgrip_model.gdfe.thesis_bars import joint_position, tension
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options

TRAVEL_MM = 12.0
SETTINGS = ClosingSettings(resolution=RESOLUTIONS["coarse"], travel_mm=TRAVEL_MM, max_iterations=40_000)


def drawn(max_tangent_unknowns: int) -> tuple[float, March, float]:
    """Return seconds, the march, and the joint's place as a share of the length."""
    case, materials = tension(poisson=0.49)
    settings = SolverSettings(
        law=ConstitutiveLaw.RIGOROUS, window=20, step_limit=1.0, max_tangent_unknowns=max_tangent_unknowns
    )
    solver = Solver(case.mesh, materials, case.supports, settings=settings)
    began = time.perf_counter()
    found = march(solver, case.loading, 10, first_guess=case.first_guess)
    seconds = time.perf_counter() - began
    if not found.completed:
        raise RuntimeError(found.reason)
    return seconds, found, joint_position(case, found.last.displacement)


class RigorousBody(Body):
    """A finger of NinjaFlex by the rigorous law, with its tangent or without."""

    def __init__(self, profile: Profile, max_tangent_unknowns: int) -> None:
        material = ninjaflex_ogden(0.49)
        super().__init__(profile, "index", SETTINGS.resolution, material=material, law=ConstitutiveLaw.RIGOROUS)
        self._max_tangent_unknowns = max_tangent_unknowns

    def new_solver(self) -> Solver:
        """Return a solver with or without the tangent."""
        made = super().new_solver()
        settings = replace(made.settings, max_tangent_unknowns=self._max_tangent_unknowns)
        return Solver(
            made.mesh, made.materials, made.supports, made.cables, settings, sections=self.finger_mesh.sections
        )


def keyframes(profile: Profile, body: Body) -> list[Equilibrium]:
    """Return the equilibria of a closing, each extrapolated from those before."""
    path = ClosingPath(profile, "index", SETTINGS, body=body)
    path.keyframes.cover(TRAVEL_MM)
    return path.keyframes._known[1:]  # noqa: SLF001  all of them, not the last alone


def steps(profile: Profile, body: Body) -> list[Equilibrium]:
    """Return equilibria at lengths up to 3 mm, each from the one before as it stands."""
    found, state = [], State(np.zeros_like(body.finger_mesh.mesh.nodes), (0.0,))
    for pulled_mm in (0.05, 0.2, 0.5, 1.0, 2.0, 3.0):
        found.append(solve_closing(SETTINGS, assumed_friction(profile), body.solver, pulled_mm, state))
        state = found[-1].state
    return found


def close_fingers() -> None:
    """Print the claims of fingers: seconds, iterations, and the longest of a solve."""
    shipped = load_directory(shipped_directory())
    for name, close, fingers in (
        ("keyframes of three fingers", keyframes, tuple(shipped)),
        ("pinch finger pulled by millimetres", steps, ("pinch",)),
    ):
        seconds, iterations, tensions = {}, {}, {}
        for cap in (0, SolverSettings().max_tangent_unknowns):
            found = []
            seconds[cap] = 0.0
            for profile in map(shipped.__getitem__, fingers):
                body = RigorousBody(profile, cap)
                _ = body.solver
                began = time.perf_counter()
                found += close(profile, body)
                seconds[cap] += time.perf_counter() - began
            if not all(one.converged for one in found):
                raise RuntimeError(f"{name}: an equilibrium was not found")
            iterations[cap] = [one.iterations for one in found]
            tensions[cap] = np.array([one.tension[0][0] for one in found])
        without, used = iterations
        apart = float(np.abs(tensions[used] / tensions[without] - 1.0).max())
        claim(
            f"{name} by the rigorous law, nu 0.49", seconds[used], "s", better="lower", goal=None,
            runs=1, peer="constant matrix and sections alone", peer_value=seconds[without],
            note=f"{sum(iterations[used])} iterations instead of {sum(iterations[without])}, {max(iterations[used])} "
            f"instead of {max(iterations[without])} at most; tensions at most {100.0 * apart:.3f} % apart",
        )  # fmt: skip


def main() -> int:
    """Print the claims."""
    no_options(__doc__)
    close_fingers()
    constant_s, constant, before = drawn(0)
    tangent_s, tangent, after = drawn(SolverSettings().max_tangent_unknowns)
    claim(
        "bar drawn by the rigorous law, nu 0.49", tangent_s, "s", better="lower", goal=None, runs=1,
        peer="the constant matrix alone", peer_value=constant_s,
        note=f"{tangent.iterations} iterations instead of {constant.iterations}; joint at {100 * after:.2f} and "
        f"{100 * before:.2f} % of the length; unstable motions at the end: {tangent.last.unstable_modes}",
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
