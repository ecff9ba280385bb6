# SPDX-License-Identifier: Apache-2.0
"""What exact gradients of the finger kernel are held against: differences of its solutions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import Finger, JointModel, MomentLaw, Solution, Strip
from softgrip_model.finger.published import TANGENT_MODULUS_MPA

Array = NDArray[np.float64]


def uneven_finger(
    joint_model: JointModel,
    *,
    joints: int = 3,
    elastic: bool = False,
    moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT,
) -> Finger:
    """Return a design off the kinks of |phi| and of the friction's clamp."""
    return Finger(
        link_mm=(45.0, 27.0, 30.0, 28.0)[:joints],
        thickness_mm=(2.7, 3.1, 3.4, 3.0)[:joints],
        length_mm=(10.0, 9.5, 11.0, 10.0)[:joints],
        routing_mm=(6.1, 7.3, 8.2, 9.4, 10.5, 11.6, 8.0, 9.0)[: 2 * joints],
        width_mm=15.0,
        strip=Strip(TANGENT_MODULUS_MPA, moment_law),
        opening_rad=(1.7, 1.4, 1.6, 1.5)[:joints],
        compliance_per_n=5e-4 if elastic else 0.0,
        lead_mm=120.0,
        base_mm=20.0,
        joint_model=joint_model,
    )


def rows(solution: Solution) -> Array:
    """Return what the gradient's rows are derivatives of, (n + 5,)."""
    return np.concatenate(
        [
            solution.angle_rad[0, 0],
            solution.tip_mm[0, 0],
            [solution.tension_n[0, 0, 0], solution.tension_n[0, 0, -1], solution.pulled_mm[0, 0]],
        ]
    )


def differences(build: Callable[[Array], Array], at: Array, step: float) -> Array:
    """Return fourth-order central differences of `build(x)` (a function to rows) in every component of `at`."""
    columns = []
    for i in range(len(at)):
        shift = np.zeros(len(at))
        shift[i] = step
        f = [build(at + k * shift) for k in (-2, -1, 1, 2)]
        columns.append((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * step))
    return np.stack(columns, axis=1)
