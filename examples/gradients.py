# SPDX-License-Identifier: Apache-2.0
"""Ask how the fingertip answers to each thickness and routing distance: exact gradients beside finite differences."""

import numpy as np

from softgrip_model.finger import Finger, Kernel
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory, shipped_directory

STEP_MM = 1e-4


def main() -> tuple[np.ndarray, np.ndarray]:
    """Return d tip / d thickness, exact and by differences, (2, joints)."""
    finger = Finger.from_profile(load_directory(shipped_directory())["pinch"], "index")
    law, joints = published("braid-tpu").law, finger.joints
    exact = Kernel([finger], law).solve([12.0], gradient=True).gradient
    tip = slice(joints, joints + 2)  # rows: joint angles, tip x, tip y, ...
    analytic = exact.thickness[0, 0, tip]

    thickness = np.array(finger.thickness_mm) + STEP_MM * np.vstack([np.eye(joints), -np.eye(joints)])
    routing = np.tile(finger.routing_mm, (2 * joints, 1))
    tips = Kernel([finger], law).varied(thickness, routing).solve([12.0]).tip_mm[:, 0]
    numeric = (tips[:joints] - tips[joints:]).T / (2 * STEP_MM)

    for axis, a, b in zip("xy", analytic, numeric, strict=True):
        print(f"d tip {axis} / d h [mm/mm]: exact {np.round(a, 3)}, differences {np.round(b, 3)}")
    return analytic, numeric


if __name__ == "__main__":
    main()
