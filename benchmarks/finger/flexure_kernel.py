# SPDX-License-Identifier: Apache-2.0
"""How well mode F closes fingers: against CalculiX on random ones that its constants were not fitted to, beside mode P.

CalculiX (C3D8I, 432 elements, with friction) has run for the seeds of softgrip_testing.calculix_flexures;
tools/docs/flexure_study.py runs it again. The peer is the kernel's own mode P in the same run.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import JointModel, Kernel
from softgrip_model.friction.published import published
from softgrip_testing.benchmark_claim import claim, no_options, spread
from softgrip_testing.calculix_flexures import UNSEEN_SEEDS, closings

LAW = published("braid-tpu-chapter4").law
RUNS = 15


def differences(joint_model: JointModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return tip differences [% of length] and tension differences [%] over the unseen fingers."""
    tips, tensions = [], []
    for one in closings():
        if one.seed not in UNSEEN_SEEDS:
            continue
        finger = one.finger.with_joint_model(joint_model)
        solution = Kernel([finger], LAW).solve(one.pulled_mm)
        tips.append(100 * np.linalg.norm(solution.tip_mm[0] - one.tip_mm, axis=1) / finger.length_from_joint_mm)
        tensions.append(100 * np.abs(solution.tension_n[0, :, 0] / one.tension_n - 1.0))
    return np.concatenate(tips), np.concatenate(tensions)


def solve_seconds(kernel: Kernel, pulls: NDArray[np.float64]) -> list[float]:
    """Return the processor's seconds a solve, run by run: one thread, each target from nothing."""
    seconds = []
    for _ in range(RUNS):
        start = time.process_time()
        kernel.solve(pulls, march=False, threads=1)
        seconds.append((time.process_time() - start) / (len(kernel) * len(pulls)))
    return seconds


def main() -> int:
    """Print the claims."""
    no_options(__doc__)
    (tip, tension), (tip_p, tension_p) = (differences(model) for model in (JointModel.FLEXURE, JointModel.HINGE))
    where = f"{len(tip)} random fingers unknown to the fit, pulled 10 to 16 mm; mean"
    claim(
        "tip error max", tip.max(), "% of length", better="lower", goal=1.0, runs=1,
        note=f"{where} {tip.mean():.2f} %", peer="mode P", peer_value=tip_p.max(),
    )  # fmt: skip
    claim(
        "tension error max", tension.max(), "%", better="lower", goal=5.0, runs=1,
        note=f"{where} {tension.mean():.1f} %", peer="mode P", peer_value=tension_p.max(),
    )  # fmt: skip
    fingers = [one.finger for one in closings() if one.seed in UNSEEN_SEEDS]
    pulls = np.linspace(0.5, 12.0, 24)
    seconds = {}
    for model in (JointModel.FLEXURE, JointModel.HINGE):
        kernel = Kernel([finger.with_joint_model(model) for finger in fingers], LAW)
        seconds[model] = solve_seconds(kernel, pulls)
    claim(
        "solve", 1e6 * statistics.median(seconds[JointModel.FLEXURE]), "us", better="lower", goal=10.0, runs=RUNS,
        note=spread(seconds[JointModel.FLEXURE], "us", 1e6) + " of processor time, each from nothing",
        peer="mode P", peer_value=1e6 * statistics.median(seconds[JointModel.HINGE]),
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
