# SPDX-License-Identifier: Apache-2.0
"""Claims 'interval coverage' and 'prediction error': fifty emulated rigs, each measured by the shipped procedure.

Every seed is another cable on another rig (friction, guide pulley, scatter, stick-slip, waves, gauge gain, stiffness).
The person sets angles with 0.5 deg of error. First the pulley is calibrated, then nine points are measured and fitted;
the law's 95 % interval is compared with the truth on the 45 settings of the thesis.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np

from softgrip_driver.rig.journal import Request
from softgrip_driver.rig.plan import ALL_ANGLES_DEG, ALL_LOADS_KG
from softgrip_driver.rig.procedure import RigSettings
from softgrip_model.friction.laws import GRAVITY
from softgrip_model.friction.record import FrictionModel
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.virtual_rig import VirtualRig

SEEDS = range(50)
GAUGE_GAIN_STDDEV = 0.001


def calibrated(seed: int, folder: Path) -> tuple[FrictionModel, VirtualRig]:
    """Calibrate pulley and cable of one rig."""
    bench = VirtualRig(seed, folder)
    pulley = bench.procedure(RigSettings()).run(Request("pulley"))
    common = float(np.hypot(pulley.pulley_stddev, GAUGE_GAIN_STDDEV))
    settings = RigSettings(pulley_ratio=pulley.pulley_ratio, common_stddev=common)
    outcome = bench.procedure(settings).run(Request("9", cable="PE braid 0.25 mm", surface="TPU"))
    assert outcome.calibration is not None
    return outcome.calibration.model, bench


def main() -> None:
    """Measure fifty rigs."""
    no_options(__doc__)
    angle, tension = np.meshgrid(np.radians(ALL_ANGLES_DEG), GRAVITY * np.array(ALL_LOADS_KG))
    covered, error, usable = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in SEEDS:
            model, bench = calibrated(seed, Path(folder) / str(seed))
            truth = bench.rig.truth.friction.ratio(angle, tension)
            low, high = model.interval(angle, tension)
            covered.append(float(np.mean((low <= truth) & (truth <= high))))
            error.append(float(np.mean(np.abs(model.ratio(angle, tension) / truth - 1.0))))
            usable += model.verdict == "usable"
            if sys.stderr.isatty():
                print(f"\rrig {seed + 1} of {len(SEEDS)}", end="", file=sys.stderr, flush=True)
    note = f"45 settings x {len(SEEDS)} rigs, 9 points each, pulley calibrated, {usable} verdicts usable; aim 90-98 %"
    claim(
        "interval coverage",
        100 * statistics.fmean(covered),
        "%",
        better="higher",
        goal=90.0,
        runs=len(SEEDS),
        note=note,
    )
    claim(
        "prediction error",
        100 * statistics.fmean(error),
        "%",
        better="lower",
        goal=2.5,
        runs=len(SEEDS),
        note=f"mean |Rf/truth - 1|; rigs {100 * min(error):.2f} .. {100 * max(error):.2f} %",
    )


if __name__ == "__main__":
    main()
