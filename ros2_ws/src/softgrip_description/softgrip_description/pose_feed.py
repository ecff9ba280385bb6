# SPDX-License-Identifier: Apache-2.0
"""What is known of the hand now: mounted fingers and how they stand; a state machine without ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from softgrip_description.errors import HandError
from softgrip_description.flexures import FingerFlexures
from softgrip_description.geometry import Array, chain_poses, flexure_names, moved_by, slot_pose
from softgrip_description.hand import Hand
from softgrip_model.profile import FingerDesign, Profile


class HandPose:
    """Mounted fingers with the state of their joints.

    Attributes:
        fingers: slot -> (profile id, design).
        joint_angles_rad: slot -> (n,), base to tip.
        displacements_m: slot -> (n, 2), of the flexures along and across.

    Args:
        hand: palm and slots.
        profiles: by id, what may be mounted.
        prefix: before every link and joint name.
    """

    def __init__(self, hand: Hand, profiles: Mapping[str, Profile], prefix: str = "") -> None:
        self._hand = hand
        self._profiles = profiles
        self._prefix = prefix
        self.fingers: dict[str, tuple[str, FingerDesign]] = {}
        self.joint_angles_rad: dict[str, tuple[float, ...]] = {}
        self.displacements_m: dict[str, Array] = {}
        self._flexures: dict[tuple[str, str], FingerFlexures] = {}

    def set_mounted(self, mounted: Mapping[str, str]) -> bool:
        """Mount finger designs.

        Args:
            mounted: slot -> profile id, of the slots that hold a finger.

        Returns:
            whether anything changed.

        Raises:
            HandError: an unknown profile or slot, or a finger that is too long for its slot; nothing changes then.
        """
        unknown = sorted({profile for profile in mounted.values() if profile not in self._profiles})
        if unknown:
            raise HandError(f"profile: expected one of {sorted(self._profiles)}, found {unknown}")
        fingers = {
            slot: (profile, self._profiles[profile].finger(slot))
            for slot, profile in mounted.items()
            if slot in self._profiles[profile].slots
        }
        self._hand.check_mounting({slot: design for slot, (_, design) in fingers.items()})
        if fingers == self.fingers:
            return False
        self.fingers = fingers
        self.joint_angles_rad = {slot: (0.0,) * design.joints for slot, (_, design) in fingers.items()}
        self.displacements_m = {slot: np.zeros((design.joints, 2)) for slot, (_, design) in fingers.items()}
        for slot, (profile, _) in fingers.items():
            if (profile, slot) not in self._flexures:
                self._flexures[profile, slot] = FingerFlexures(self._profiles[profile], slot)
        return True

    def set_finger(self, finger: str, angles_rad: Sequence[float], tip_m: Sequence[float]) -> bool:
        """Take a finger's joint angles, base to tip [rad], and its tip, (2,) [m]; return whether they were taken.

        Angles of a finger that is not mounted, of another number than it has joints, or that are not finite are not
        taken: the finger keeps its last pose.
        """
        if finger not in self.fingers or len(angles_rad) != self.fingers[finger][1].joints:
            return False
        if not all(math.isfinite(angle) for angle in angles_rad):
            return False
        angles = tuple(float(angle) for angle in angles_rad)
        self.joint_angles_rad[finger] = angles
        self.displacements_m[finger] = self.displacements_of(finger, angles, tip_m)
        return True

    def displacements_of(self, finger: str, angles_rad: Sequence[float], tip_m: Sequence[float]) -> Array:
        """Return how the flexures of a mounted finger give at these angles, with this tip; (n, 2), along and across."""
        return self._flexures[self.fingers[finger][0], finger].displacements_m(tuple(angles_rad), tip_m)

    def joint_state(self) -> tuple[list[str], list[float]]:
        """Return names and positions of all mounted fingers' joints, by `flexure_names`: [m], [m], [rad]."""
        names: list[str] = []
        positions: list[float] = []
        for slot, angles in self.joint_angles_rad.items():
            for j, (angle, displacement) in enumerate(zip(angles, self.displacements_m[slot].tolist(), strict=True)):
                names += flexure_names("joint", slot, j, self._prefix)
                positions += [*displacement, angle]
        return names, positions

    def link_transforms(self) -> list[tuple[str, str, Array]]:
        """Return (parent frame, child frame, pose (4, 4)) of every link that moves."""
        transforms = []
        for slot, angles in self.joint_angles_rad.items():
            base, design = f"{self._prefix}{slot}_base", self.fingers[slot][1]
            for j, poses in enumerate(chain_poses(design, angles, self.displacements_m[slot])):
                names = flexure_names("link", slot, j, self._prefix)
                transforms += [(base, name, pose) for name, pose in zip(names, poses, strict=True)]
        return transforms

    def mount_transforms(self) -> list[tuple[str, str, Array]]:
        """Return (parent frame, child frame, pose (4, 4)) of finger bases and tips, which move with swaps only."""
        transforms = []
        for slot, (_, design) in self.fingers.items():
            base, last = f"{self._prefix}{slot}_base", f"{self._prefix}{slot}_link_{design.joints - 1}"
            transforms.append((f"{self._prefix}palm", base, slot_pose(self._hand.slots[slot])))
            transforms.append((last, f"{self._prefix}{slot}_tip", moved_by(design.link_lengths_m[-1])))
        return transforms
