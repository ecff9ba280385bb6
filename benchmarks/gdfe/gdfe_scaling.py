# SPDX-License-Identifier: Apache-2.0
"""Iterations and increments per second of the GDFE solver, 500 to 100,000 hexahedra, beside the bandwidth roof.

Two-material bars (Cheetah, NinjaFlex; calibrated law, proj) drawn by 10 % per increment. An iteration is one local step
of all elements and one application of the constant matrix' inverse (a factor, multigrid from 20,000 nodes on), Anderson
window 10. The roof is the rate at which this machine, in the same run, with the same threads, reads the bytes that an
iteration must move (Solver.bytes_per_iteration says which) over and over from a working set of that size.

From 30k on an increment is also computed with a direct factor, by itself ('increments rate') and with the set-up before
it ('first increment rate').
"""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import dataclass

import numpy as np

from softgrip_model.gdfe import Method, Solver, SolverSettings, State, Supports, bar
from softgrip_model.gdfe._core import read_bandwidth, simd_target
from softgrip_model.gdfe.materials import cheetah, ninjaflex
from softgrip_testing.benchmark_claim import claim, no_options, spread


@dataclass(frozen=True)
class Size:
    """Elements of a bar and what is aimed at."""

    shape: tuple[int, int, int]
    iterations_aim: float | None = None
    roof_aim: float | None = None
    direct_aim: float | None = None
    """Increments per second over those with a direct factor; None = not compared."""


SIZES = {
    "500": Size((20, 5, 5)),
    "1250": Size((50, 5, 5)),
    "2000": Size((80, 5, 5), iterations_aim=7000.0),
    "10k": Size((64, 13, 12), roof_aim=0.5),
    "30k": Size((92, 18, 18), direct_aim=1.0),
    "100k": Size((99, 32, 33), direct_aim=5.0),
}
RUNS = 7
LONG_RUNS = 3
LONG_FROM = 20_000
THREADS = (1, 2)
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Case:
    """A prepared solver and one increment."""

    solver: Solver
    moved: np.ndarray
    start: State
    set_up_s: float
    threads: int

    @property
    def hexes(self) -> int:
        """Elements."""
        return len(self.solver.mesh.hexes)

    @property
    def runs(self) -> int:
        """How often it is measured."""
        return LONG_RUNS if self.hexes > LONG_FROM else RUNS


def make(shape: tuple[int, int, int], threads: int, method: Method = Method.AUTOMATIC) -> Case:
    """Return a solver, the displacement of one increment of 10 %, and a start near it."""
    size = (2.0 * shape[0], 2.0 * shape[1], 2.0 * shape[2])
    mesh = bar(size, shape, 2)
    left = mesh.nodes_where(mesh.nodes[:, 0] < 1e-9)
    right = mesh.nodes_where(mesh.nodes[:, 0] > size[0] - 1e-9)
    supports = Supports.none(len(mesh.nodes)).with_prescribed(left).with_prescribed(right)
    moved = np.zeros_like(mesh.nodes)
    moved[right, 0] = 0.1 * size[0]
    started = time.perf_counter()
    solver = Solver(mesh, [cheetah(), ninjaflex()], supports, settings=SolverSettings(threads=threads, method=method))
    return Case(solver, moved, State(mesh.nodes * [0.1, -0.04, -0.04]), time.perf_counter() - started, threads)


def iteration_rates(case: Case) -> list[float]:
    """Return iterations per second of several runs of a fixed number of iterations."""
    count = max(20, int(5e5 / case.hexes))
    rates = []
    for _ in range(case.runs):
        started = time.perf_counter()
        found = case.solver.solve(case.moved, start=case.start, tolerance=1e-300, max_iterations=count)
        rates.append(found.iterations / (time.perf_counter() - started))
    return rates


def increment_rates(case: Case) -> tuple[list[float], int]:
    """Return converged increments per second and their iterations."""
    rates, iterations = [], 0
    for _ in range(case.runs):
        started = time.perf_counter()
        found = case.solver.solve(case.moved, start=case.start, tolerance=TOLERANCE)
        rates.append(1.0 / (time.perf_counter() - started))
        if not found.converged:
            raise RuntimeError(f"no convergence: residual {found.residual:.1e}")
        iterations = found.iterations
    return rates, iterations


def fastest(size: Size) -> tuple[Case, list[float]]:
    """Return the case with the number of threads that iterates fastest, and its rates."""
    cases = [make(size.shape, threads) for threads in THREADS]
    rates = [iteration_rates(case) for case in cases]
    best = max(range(len(cases)), key=lambda i: statistics.median(rates[i]))
    return cases[best], rates[best]


def claim_increments(label: str, size: Size, case: Case) -> None:
    """Print the claim of the increments; on large meshes beside those with a direct factor."""
    rates, iterations = increment_rates(case)
    rate, peer_rate = statistics.median(rates), None
    note = f"10 % elongation to {TOLERANCE:g}, {iterations} iterations, set-up {case.set_up_s:.2f} s; "
    note += spread(rates, "1/s")
    if size.direct_aim is not None:
        direct = make(size.shape, case.threads, Method.DIRECT)
        peer_rates, peer_iterations = increment_rates(direct)
        peer_rate = statistics.median(peer_rates)
        first, peer_first = case.set_up_s + 1.0 / rate, direct.set_up_s + 1.0 / peer_rate
        note += f"; direct: {peer_iterations} iterations, set-up {direct.set_up_s:.2f} s, {spread(peer_rates, '1/s')}"
        claim(
            f"{label} hexes first increment rate",
            1.0 / first,
            "1/s",
            better="higher",
            goal=size.direct_aim / peer_first,
            runs=case.runs,
            note="set-up and one increment; the set-up measured once, the increment as in 'increments rate'",
            peer="direct factor, same threads",
            peer_value=1.0 / peer_first,
        )
    claim(
        f"{label} hexes increments rate",
        rate,
        "1/s",
        better="higher",
        goal=None if peer_rate is None else size.direct_aim * peer_rate,
        runs=case.runs,
        note=note,
        peer="" if peer_rate is None else "direct factor, same threads",
        peer_value=peer_rate,
    )


def main() -> int:
    """Print three claims per size, four where a direct factor is the peer."""
    no_options(__doc__)
    for label, size in SIZES.items():
        case, rates = fastest(size)
        rate = statistics.median(rates)
        moved_bytes = case.solver.bytes_per_iteration
        roof = read_bandwidth(moved_bytes, case.threads, 200 if case.hexes < LONG_FROM else 30) / moved_bytes
        entries = case.solver.matrix_entries
        what = f"{case.hexes} hexahedra, {entries} matrix entries, {case.threads} thread(s), {simd_target()}"
        claim(
            f"{label} hexes iterations rate",
            rate,
            "1/s",
            better="higher",
            goal=size.iterations_aim,
            runs=case.runs,
            note=f"{what}; {spread(rates, '1/s')}; {moved_bytes / 1e6:.2f} MB per iteration",
        )
        claim_increments(label, size, case)
        claim(
            f"{label} hexes roof share",
            rate / roof,
            "1",
            better="higher",
            goal=size.roof_aim,
            runs=case.runs,
            peer="reading the same bytes",
            peer_value=1.0,
            note=f"roof {roof:.0f} iterations/s at {roof * moved_bytes / 1e9:.1f} GB/s with {case.threads} thread(s)",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
