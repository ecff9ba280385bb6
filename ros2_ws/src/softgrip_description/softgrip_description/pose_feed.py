# SPDX-License-Identifier: Apache-2.0
"""What is known of the hand now: mounted fingers and their joint angles; a state machine without ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from softgrip_description.errors import HandError
from softgrip_description.geometry import Array, finger_joint_names, link_poses, slot_pose
from softgrip_description.hand import Hand
from softgrip_model.profile import FingerDesign, Profile


class HandPose:
    """Mounted fingers with their joint angles.

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
        return True

    def set_joint_angles(self, finger: str, angles_rad: Sequence[float]) -> bool:
        """Take a finger's joint angles, base to tip [rad]; return whether they were taken.

        Angles of a finger that is not mounted, of another number than it has joints, or that are not finite are not
        taken: the finger keeps its last pose.
        """
        if finger not in self.fingers or len(angles_rad) != self.fingers[finger][1].joints:
            return False
        if not all(math.isfinite(angle) for angle in angles_rad):
            return False
        self.joint_angles_rad[finger] = tuple(float(angle) for angle in angles_rad)
        return True

    def joint_state(self) -> tuple[list[str], list[float]]:
        """Return joint names and angles [rad] of all mounted fingers."""
        names: list[str] = []
        angles: list[float] = []
        for slot, finger_angles in self.joint_angles_rad.items():
            names += finger_joint_names(slot, len(finger_angles), self._prefix)
            angles += finger_angles
        return names, angles

    def link_transforms(self) -> list[tuple[str, str, Array]]:
        """Return (parent frame, child frame, pose (4, 4)) of every link that moves."""
        transforms = []
        for slot, angles in self.joint_angles_rad.items():
            design = self.fingers[slot][1]
            base = f"{self._prefix}{slot}_base"
            for j, pose in enumerate(link_poses(design, angles)[:-1]):
                transforms.append((base, f"{self._prefix}{slot}_link_{j}", pose))
        return transforms

    def mount_transforms(self) -> list[tuple[str, str, Array]]:
        """Return (parent frame, child frame, pose (4, 4)) of finger bases and tips, which move with swaps only."""
        transforms = []
        for slot, (_, design) in self.fingers.items():
            base, last = f"{self._prefix}{slot}_base", f"{self._prefix}{slot}_link_{design.joints - 1}"
            transforms.append((f"{self._prefix}palm", base, slot_pose(self._hand.slots[slot])))
            tip = link_poses(design, [0.0] * design.joints)[0].copy()
            tip[0, 3] = design.link_lengths_m[-1]
            transforms.append((last, f"{self._prefix}{slot}_tip", tip))
        return transforms
