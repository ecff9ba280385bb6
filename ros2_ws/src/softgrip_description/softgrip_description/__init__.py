# SPDX-License-Identifier: Apache-2.0
"""The hand, described once: palm, slots, finger bases, tool centre points; from it URDF, xacro, tf and joints.

MJCF asks the finger kernel how a joint gives: `softgrip_description.mjcf`, which the emulator does not import.

Example:
    >>> from softgrip_description import shipped_hand, urdf_of
    >>> from softgrip_model.profile import load
    >>> profile = load(profiles / "power.yaml")
    >>> text = urdf_of(shipped_hand(), {slot: (profile.id, profile.finger(slot)) for slot in profile.slots})
"""

from softgrip_description.errors import HandError
from softgrip_description.geometry import finger_joint_names, flexure_names, link_poses, slot_pose
from softgrip_description.hand import Hand, HandSlot, load_hand, shipped_hand
from softgrip_description.urdf import urdf_of
from softgrip_description.xacro_macro import macro_of

__all__ = [
    "Hand",
    "HandError",
    "HandSlot",
    "finger_joint_names",
    "flexure_names",
    "link_poses",
    "load_hand",
    "macro_of",
    "shipped_hand",
    "slot_pose",
    "urdf_of",
]
