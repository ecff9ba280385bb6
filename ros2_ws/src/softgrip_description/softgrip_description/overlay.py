# SPDX-License-Identifier: Apache-2.0
"""What a viewer draws over the described hand: cables coloured by tension, measured fingers, contacts; without ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_description.geometry import Array, link_poses
from softgrip_description.mjcf import routing_points_m
from softgrip_model.profile import FingerDesign

#: A cable of this tension [N] has the last colour: what gripper_command pulls with unless a goal says otherwise.
FULL_TENSION_N = 20.0
#: Diameter of a contact's sphere [m/N]; contact tensions below are left out [N].
CONTACT_M_PER_N, SMALLEST_CONTACT_N = 0.001, 1.0

Colour = tuple[float, float, float, float]

_SLACK, _TIGHT, _UNKNOWN = (0.13, 0.40, 0.67), (0.84, 0.19, 0.15), (0.6, 0.6, 0.6)


@dataclass(frozen=True)
class CablePicture:
    """The cable of a finger between its routing points.

    Attributes:
        points_m: (2 n, 3) in ``<finger>_base``, base to tip.
        colours: (2 n - 1) of the spans between them.
    """

    points_m: NDArray[np.float64]
    colours: list[Colour]


def cable_picture(
    design: FingerDesign, joint_angles_rad: Sequence[float], displacements_m: Array, tensions_n: Sequence[float]
) -> CablePicture:
    """Return where a finger's cable runs.

    Args:
        design: a finger of n joints.
        joint_angles_rad: (n,), positive when closed.
        displacements_m: (n, 2), of the flexures along and across.
        tensions_n: (2 n + 1,) of the cable's spans, actuator to tip, as in finger/predicted; else they are unknown.
    """
    poses = [*link_poses(design, joint_angles_rad, displacements_m)[:-1], np.eye(4)]  # -1 is the base
    points = [poses[link] @ (*point, 0.0, 1.0) for link, point in routing_points_m(design)]
    known = len(tensions_n) == len(points) + 1
    between = tensions_n[1:-1] if known else [math.nan] * (len(points) - 1)
    return CablePicture(np.array(points)[:, :3], [tension_colour(tension_n) for tension_n in between])


def measured_line_m(design: FingerDesign, joint_angles_rad: Sequence[float], tip_m: Sequence[float]) -> Array:
    """Return joints and tip of a finger as the camera sees it, (n + 1, 3) [m] in ``<finger>_base``.

    The tip is the measured one; the joints are those of rigid links at the measured angles.
    """
    points = np.array([pose[:3, 3] for pose in link_poses(design, joint_angles_rad)])
    points[-1, :2] = tip_m
    return points


def tension_colour(tension_n: float) -> Colour:
    """Return blue for a slack cable, red from `FULL_TENSION_N` on, grey where the tension is not known."""
    if not math.isfinite(tension_n):
        return (*_UNKNOWN, 1.0)
    share = min(max(tension_n / FULL_TENSION_N, 0.0), 1.0)
    red, green, blue = (slack + share * (tight - slack) for slack, tight in zip(_SLACK, _TIGHT, strict=True))
    return (red, green, blue, 1.0)


def contact_diameter_m(tension_n: float, free_tension_n: float) -> float:
    """Return how large a contact is drawn [m]: in proportion to the tension beyond the free motion's; 0 = not at all.

    It is a picture. Whether a finger touches something is decided by the grasp's own test (docs/cell.md).
    """
    contact_n = tension_n - free_tension_n
    return CONTACT_M_PER_N * contact_n if contact_n >= SMALLEST_CONTACT_N else 0.0  # NaN is not drawn
