# SPDX-License-Identifier: Apache-2.0
"""What a gradient of the mesh costs beside the shape itself: the shipped index fingers, 2,088 hexahedra, one thread.

A shape: from rest to 10 mm pulled, to a residual of 1e-10. Its gradient: where the tip is, one joint's angle and the
tension, each to three h, six r, the moduli and the pulled length (33 slopes). Both in the same run, in turns; and the
slopes beside central differences of whole shapes.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np

from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe.closing import ClosingSettings, profile_material
from softgrip_model.gdfe.finger_gradient import Goal, MeshedFinger, joint_angle_goal, tension_goal, tip_goal
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options, spread

RUNS = 3
PULLED_MM = 10.0
STEP_MM = 2e-4
GOALS: list[Goal] = [tip_goal([0.0, 1.0, 0.0]), joint_angle_goal(1), tension_goal()]
SETTINGS = ClosingSettings(travel_mm=PULLED_MM + 1.0, max_iterations=1000)


def meshed(profile: Profile, variable: int = 0, step_mm: float = 0.0) -> MeshedFinger:
    """Return an index finger of a profile, one of its h and r changed."""
    finger = Finger.from_profile(profile, "index")
    design = np.concatenate([finger.thickness_mm, finger.routing_mm])
    design[variable] += step_mm
    changed = finger.with_design(design[: finger.joints], design[finger.joints :])
    return MeshedFinger(changed, assumed_friction(profile).law, profile_material(profile.material), SETTINGS)


def values(finger: MeshedFinger, pulled_mm: float = PULLED_MM) -> np.ndarray:
    """Return the goals of a whole shape."""
    closed = finger.close(pulled_mm)
    vertices = finger.mesh.mesh.nodes + closed.displacement
    return np.array([goal(finger.mesh, vertices, closed.tension[0][0]).value for goal in GOALS])


def error(profile: Profile) -> float:
    """Return the largest difference of slopes, as a share of a goal's largest slope: h 1, r 2 and the pulled length."""
    finger = meshed(profile)
    found = np.array([one.numbers() for one in finger.gradients(finger.close(PULLED_MM), PULLED_MM, GOALS)])
    largest = np.abs(found).max(axis=1)
    worst = 0.0
    for variable in (0, 4, 10):
        if variable == 10:
            more, less = (values(finger, PULLED_MM + side * STEP_MM) for side in (1.0, -1.0))
        else:
            more, less = (values(meshed(profile, variable, side * STEP_MM)) for side in (1.0, -1.0))
        worst = max(worst, float((np.abs((more - less) / (2.0 * STEP_MM) - found[:, variable]) / largest).max()))
    return worst


def main() -> int:
    """Print the claim."""
    no_options(__doc__)
    profiles = list(load_directory(shipped_directory()).values())
    shapes, gradients = [], []
    for _ in range(RUNS):
        for profile in profiles:
            finger = meshed(profile)
            began = time.perf_counter()
            closed = finger.close(PULLED_MM)
            between = time.perf_counter()
            finger.gradients(closed, PULLED_MM, GOALS)
            shapes.append(between - began)
            gradients.append(time.perf_counter() - between)
    ratios = [gradient / shape for gradient, shape in zip(gradients, shapes, strict=True)]
    claim(
        "33 slopes of a finger's shape in the mesh",
        statistics.median(ratios),
        "shapes",
        better="lower",
        goal=3.0,
        runs=len(ratios),
        note=f"{spread(ratios, 'shapes')}; gradient {1e3 * statistics.median(gradients):.0f} ms; largest difference "
        f"from central differences {max(map(error, profiles)):.1e} of a goal's largest slope (aim 1e-5)",
        peer="one shape from rest",
        peer_value=1.0,
    )
    print(f"shape {statistics.median(shapes):.2f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
