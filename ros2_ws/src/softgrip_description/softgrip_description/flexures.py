# SPDX-License-Identifier: Apache-2.0
"""How far a finger's flexures displace the links beyond them, so that its chain of joints ends at the tip there is.

A strip bends along an arc, shortens and shears (docs/finger.md, mode F): beside its angle a joint has a displacement of
the link beyond it. The messages carry angles and tip; the displacements follow from both. A tip of rigid links (modes P
and R, and finger/measured, whose chain is rigid) leaves none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_description.geometry import max_displacement_m
from softgrip_model.finger import Finger, FingerError, Path, Plane, follow
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.profile import Profile

Array = NDArray[np.float64]
#: Vectors of the finger's plane as x + i y; multiplied by exp(-i angle) they are turned as a closing joint turns.
Vectors = NDArray[np.complex128]

#: Pulled lengths [mm] at which the free closing is computed; between two, displacements are linear within 1 um.
_PULLED_MM = np.arange(0.5, 25.5, 0.5)
#: [mm] further away than any finger reaches: a plane that no link touches.
_FAR_MM = 1e4


class FingerFlexures:
    """The displacements of one finger's n joints; along x of the link before, and across it, towards closing.

    Args:
        profile: of the finger.
        slot: that it is mounted in.

    Raises:
        ProfileError: a profile without a finger for the slot.
    """

    def __init__(self, profile: Profile, slot: str) -> None:
        self._design = design = profile.finger(slot)
        self._links_m = np.array(design.link_lengths_m)
        self._limits_m = np.array([[max_displacement_m(design, j)] for j in range(design.joints)])
        self._free = _free_closing(profile, slot)

    def displacements_m(self, joint_angles_rad: Sequence[float], tip_m: Sequence[float]) -> Array:
        """Return the displacements with which the chain of joints ends at a tip.

        They are those of the free closing at the same angles, by the share of them that the tip shows, and of what
        is then left of the tip's way an equal part each.

        Args:
            joint_angles_rad: (n,), positive when closed.
            tip_m: (2,) in ``<finger>_base``.

        Returns:
            (n, 2), along and across; zeros where the tip is unknown, or further off than `max_displacement_m` allows.
        """
        beyond = np.exp(-1j * np.cumsum(joint_angles_rad))
        before = np.concatenate([[1.0 + 0.0j], beyond[:-1]])
        rest = complex(tip_m[0], tip_m[1]) - self._links_m @ beyond
        free = before * [
            np.interp(angle, angles, displacements)
            for angle, (angles, displacements) in zip(joint_angles_rad, self._free, strict=True)
        ]
        total = free.sum()
        size = abs(total) ** 2
        share = min(max((total.conjugate() * rest).real / size, 0.0), 1.0) if size > 0.0 else 0.0
        found = (share * free + (rest - share * total) / len(free)) / before
        displacements = np.column_stack([found.real, -found.imag])
        return displacements if (np.abs(displacements) <= self._limits_m).all() else np.zeros_like(displacements)


def _free_closing(profile: Profile, slot: str) -> list[tuple[Array, Vectors]]:
    """Return angles [rad], ascending from 0, and displacements [m] at them, of each joint of the closing finger.

    Of a finger that the kernel can not compute nothing but the straight state is known.
    """
    finger = Finger.from_profile(profile, slot)
    try:
        law = assumed_friction(profile).law
        # how far a link's middle is from a plane is where it is
        paths = [
            follow(
                finger,
                law,
                _PULLED_MM,
                contacts=[Plane(normal, -_FAR_MM, j, 0.5 * length) for j, length in enumerate(finger.link_mm)],
            )
            for normal in ((1.0, 0.0), (0.0, 1.0))
        ]
    except FingerError:
        return [(np.zeros(1), np.zeros(1, dtype=np.complex128))] * finger.joints
    return _displacements(finger, *paths)


def _displacements(finger: Finger, x: Path, y: Path) -> list[tuple[Array, Vectors]]:
    known = ~(x.failed | y.failed)
    angles = np.vstack([np.zeros(finger.joints), x.angle_rad[known]])
    links = np.array(finger.link_mm)
    straight = np.cumsum(links) - 0.5 * links
    middles = np.vstack([straight, x.gap[known] - _FAR_MM + 1j * (y.gap[known] - _FAR_MM)])
    tips = np.concatenate([[links.sum()], x.tip_mm[known] @ [1.0, 1.0j]])
    beyond = np.exp(-1j * np.cumsum(angles, axis=1))
    before = np.column_stack([np.ones(len(angles)), beyond[:, :-1]])
    begins = middles - 0.5 * links * beyond
    begins[:, -1] = tips - links[-1] * beyond[:, -1]  # the last link bends a little: its end counts
    ends = np.column_stack([np.zeros(len(angles)), begins + links * beyond])[:, :-1]
    displacements = 1e-3 * (begins - ends) / before
    tables = []
    for angle, displacement in zip(angles.T, displacements.T, strict=True):
        further = np.concatenate([[True], angle[1:] > np.maximum.accumulate(angle)[:-1]])
        tables.append((angle[further], displacement[further]))
    return tables
