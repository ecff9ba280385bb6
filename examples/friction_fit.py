# SPDX-License-Identifier: Apache-2.0
"""Fit a friction law to measured points, and see how far to trust it."""

import numpy as np

from softgrip_model.friction.calibration import Calibration, SurfacePair, calibrate
from softgrip_model.friction.laws import Law
from softgrip_model.friction.measurements import measurements
from softgrip_model.friction.published import published


def main() -> Calibration:
    """Measure nine points of a known cable with 1 % of noise, and fit them."""
    truth = published("braid-tpu")
    angle, load = (grid.ravel() for grid in np.meshgrid(np.radians([10, 50, 90]), 9.81 * np.array([0.2, 0.6, 1.0])))
    noise = np.exp(0.01 * np.random.default_rng(1).standard_normal(9))
    points = measurements(angle, load, truth.ratio(angle, load) * noise * load)  # angle [rad], T2 [N], T1 [N]

    pair = SurfacePair("PE braid 0.25 mm", "TPU", cable_radius_m=0.125e-3, surface_radius_m=3e-3)
    found = calibrate(points, pair, Law.MATTE)

    asked = np.radians([30.0, 70.0])
    low, high = found.model.interval(asked, 4.0)
    for theta, fitted, a, b, real in zip(
        asked, found.model.ratio(asked, 4.0), low, high, truth.ratio(asked, 4.0), strict=True
    ):
        print(f"{np.degrees(theta):3.0f} deg, 4 N: T1/T2 = {fitted:.3f}, 95 % in {a:.3f} .. {b:.3f}, truth {real:.3f}")
    print(f"verdict: {found.model.verdict.name}")
    return found


if __name__ == "__main__":
    main()
