# SPDX-License-Identifier: Apache-2.0
"""How far a finger leaves the plane that it closes in, to first order. SI units.

The plant's mechanics are those of the plane. What turns a finger out of it is small: it is mounted with a roll about
its own axis, and each strip twists under what does not pull in the plane. A cable beside the strip's middle pulls the
link beyond sideways with tension times offset; about the axis of that link this is the sine of the joint's turn of it.
A product pushes on a rolled finger partly sideways, on the inner side of its body. Strips bend sideways too little to
be seen: a strip of h x w is (w / h)^2 = 25 times stiffer that way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_emulator.plant.truth import FingerTruth

    Array = NDArray[np.float64]


def torsional_stiffness(finger: FingerTruth) -> Array:
    """Return G J / l of each strip [N m/rad], (n,): a rectangle's J = w h^3 / 3 (1 - 0.63 h / w) (Saint-Venant)."""
    shear_pa = finger.stiffness * finger.stress_tension_pa[0] / (2.0 * (1.0 + finger.poisson))
    thickness, width = finger.thickness_m, finger.width_m
    torsion_m4 = width * thickness**3 / 3.0 * (1.0 - 0.63 * thickness / width)
    return np.asarray(shear_pa * torsion_m4 / finger.strip_lengths_m)


def twist(finger: FingerTruth, q: Array, groove_tension_n: Array, push_n: float) -> Array:
    """Return how far each link is twisted against the one before [rad], (n,).

    Args:
        finger: as it came out.
        q: joint angles [rad], (n,).
        groove_tension_n: of the cable across each groove, (n,).
        push_n: of a product on the finger.
    """
    by_cable = groove_tension_n * finger.cable_aside_m * np.sin(q)
    by_product = push_n * np.sin(finger.mounting_roll_rad) * finger.body_height_m
    return np.asarray((by_cable + by_product) / torsional_stiffness(finger))


def leave_plane(finger: FingerTruth, joints_m: Array, headings_rad: Array, twist_rad: Array) -> Array:
    """Return joints and tip (n + 1, 3) as they are, from those in the finger's plane (n + 1, 2).

    The third coordinate points out of the plane that the camera is calibrated for.
    """
    aside_m = np.zeros(len(joints_m))
    for joint, (heading, turn) in enumerate(zip(headings_rad, twist_rad, strict=True)):
        # A link turned about its own direction lifts what lies beside that line.
        along = np.array([np.cos(heading), -np.sin(heading)])
        away = joints_m[joint + 1 :] - joints_m[joint]
        aside_m[joint + 1 :] += turn * (along[0] * away[:, 1] - along[1] * away[:, 0])
    cos, sin = np.cos(finger.mounting_roll_rad), np.sin(finger.mounting_roll_rad)
    x, y = joints_m.T
    return np.stack([x, cos * y - sin * aside_m, sin * y + cos * aside_m], axis=1)
