# SPDX-License-Identifier: Apache-2.0
"""The three bars of thesis section 5.4: our whole simulation against CalculiX with two threads, in one run.

Ours: mesh, set-up, factor, solve, result file, in a running Python; the same as a new process is in the note. CalculiX:
its whole process on the shipped deck. The error is that of the calibrated law against CalculiX' displacements, as a
share of the largest.
"""

from __future__ import annotations

import gzip
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import resources
from pathlib import Path

from softgrip_model.gdfe import Solver, SolverSettings, VolumeShape
from softgrip_model.gdfe.march import March, march
from softgrip_model.gdfe.materials import SolidMaterial
from softgrip_model.gdfe.mesh_file import write_mesh
from softgrip_model.gdfe.thesis_bars import BarCase, difference, five_materials, rotation, tension
from softgrip_testing.benchmark_claim import claim, no_options, spread, timed

#: name -> case, volume shape, runs of CalculiX, aim of the ratio.
CASES: dict[str, tuple[Callable[[], tuple[BarCase, list[SolidMaterial]]], VolumeShape, int, float]] = {
    "five-material bar": (five_materials, VolumeShape.SCALE, 3, 100.0),
    "rotation": (rotation, VolumeShape.PROJ, 2, 100.0),
    "tension": (tension, VolumeShape.PROJ, 5, 50.0),
}
RUNS = 9
#: The calibrated law does not depend on the path, so one increment carries the whole load.
INCREMENTS = 1
TOLERANCE = 1e-6
ERROR_GOAL_PERCENT = 0.5


def simulate(name: str, folder: Path) -> tuple[BarCase, March]:
    """Run one whole simulation; return what was loaded, and how it ended."""
    make, shape, _, _ = CASES[name]
    case, materials = make()
    solver = Solver(case.mesh, materials, case.supports, settings=SolverSettings(volume_shape=shape))
    found = march(solver, case.loading, INCREMENTS, tolerance=TOLERANCE, first_guess=case.first_guess)
    if not found.completed:
        raise RuntimeError(f"{name}: {found.reason}")
    write_mesh(folder / "result.vtu", case.mesh, found.last.displacement, cell_data={"strain": found.last.strain})
    return case, found


def calculix(deck: str, runs: int, folder: Path) -> list[float]:
    """Return the seconds of CalculiX' process on a shipped deck."""
    packed = resources.files("softgrip_model.gdfe") / "reference" / f"{deck}.inp.gz"
    (folder / "job.inp").write_bytes(gzip.decompress(packed.read_bytes()))
    seconds = []
    for _ in range(runs):
        started = time.perf_counter()
        subprocess.run(
            ["ccx", "job"], cwd=folder, env={**os.environ, "OMP_NUM_THREADS": "2"}, check=True, capture_output=True
        )
        seconds.append(time.perf_counter() - started)
    return seconds


def main() -> int:
    """Print two claims per case."""
    if len(sys.argv) == 3 and sys.argv[1] == "--once":  # the same simulation as a process of its own
        with tempfile.TemporaryDirectory() as folder:
            simulate(sys.argv[2], Path(folder))
        return 0
    no_options(__doc__)
    have_peer = shutil.which("ccx") is not None
    if not have_peer:
        print("CalculiX not found: apt-get install calculix-ccx; only our own figures follow", file=sys.stderr)
    for name, (_, _, runs, aim) in CASES.items():
        with tempfile.TemporaryDirectory() as folder_name:
            folder = Path(folder_name)
            case, found = simulate(name, folder)
            mean, largest = difference(found.last.displacement, case.reference())
            ours = timed(lambda name=name, folder=folder: simulate(name, folder), RUNS)
            whole = timed(lambda name=name: subprocess.run([sys.executable, __file__, "--once", name], check=True), 2)
            peer = calculix(case.deck, runs, folder) if have_peer else []
        peer_value = statistics.median(peer) if peer else None
        cold = statistics.median(whole)
        note = (
            f"{spread(ours, 'ms', 1e3)}; {found.iterations} iterations to {TOLERANCE:g}; "
            f"as a new Python process {cold:.2f} s"
        )
        if peer:
            note += f" ({statistics.median(peer) / cold:.1f} times CalculiX); CalculiX 2 threads {spread(peer, 's')}"
        claim(
            f"{name} time",
            statistics.median(ours),
            "s",
            better="lower",
            goal=None if peer_value is None else peer_value / aim,
            runs=RUNS,
            note=note,
            peer="CalculiX 2.20, 2 threads, whole process" if peer else "",
            peer_value=peer_value,
        )
        claim(
            f"{name} error",
            100.0 * mean,
            "%",
            better="lower",
            goal=ERROR_GOAL_PERCENT,
            runs=1,
            note=f"mean over nodes, of the largest displacement; largest {100 * largest:.2f} %; calibrated law",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
