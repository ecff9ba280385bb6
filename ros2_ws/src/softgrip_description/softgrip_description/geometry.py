# SPDX-License-Identifier: Apache-2.0
"""Where every link of a finger is: frames of slots and links as 4x4 matrices.

Frames (docs/conventions.md): ``<finger>_base`` has x along the straight finger from the first joint, closes towards
-y, z completes a right-handed frame. Joint angles grow as the finger closes, so every joint turns about -z. A flexure
is three joints: it displaces the link beyond along the link before and across it, towards -y, and turns it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_description.hand import HandSlot
from softgrip_model.profile import FingerDesign

Array = NDArray[np.float64]

#: The three joints of a flexure, from the link before to the one beyond.
_FLEXURE_SUFFIXES = ("_along", "_across", "")


def finger_joint_names(finger: str, joints: int, prefix: str = "") -> list[str]:
    """Return the names of a finger's joints that turn, base to tip."""
    return [f"{prefix}{finger}_joint_{j}" for j in range(joints)]


def flexure_names(kind: str, finger: str, joint: int, prefix: str = "") -> list[str]:
    """Return the names of a flexure's joints that displace along, displace across, and turn, or of what they move.

    Args:
        kind: "joint", or "link" for the links that they move.
        finger: its slot.
        joint: 0 is the one next to the base.
        prefix: before every name.
    """
    return [f"{prefix}{finger}_{kind}_{joint}{suffix}" for suffix in _FLEXURE_SUFFIXES]


def max_displacement_m(design: FingerDesign, joint: int) -> float:
    """Return how far a flexure may displace its link along or across [m]: half its strip's length."""
    return 0.5 * design.joint_lengths_m[joint]


def slot_pose(slot: HandSlot) -> Array:
    """Return the pose of ``<finger>_base`` in `palm`, (4, 4).

    x points along the straight finger; -y, the direction of closing, lies in the plane of x and z of the palm.
    """
    side, cos, sin = -slot.closes_towards_x, math.cos(slot.rest_angle_rad), math.sin(slot.rest_angle_rad)
    pose = np.eye(4)
    pose[:3, 0] = (side * cos, 0.0, sin)
    pose[:3, 1] = (side * sin, 0.0, -cos)
    pose[:3, 2] = (0.0, side, 0.0)
    pose[:3, 3] = slot.position_m
    return pose


def turned_by(joint_angle_rad: float) -> Array:
    """Return the pose of a link after its joint has closed by an angle [rad], in the frame before the joint, (4, 4)."""
    cos, sin = math.cos(joint_angle_rad), math.sin(joint_angle_rad)
    pose = np.eye(4)
    pose[:2, :2] = ((cos, sin), (-sin, cos))
    return pose


def moved_by(x_m: float, y_m: float = 0.0) -> Array:
    """Return a displacement along x and y [m], (4, 4)."""
    pose = np.eye(4)
    pose[0, 3], pose[1, 3] = x_m, y_m
    return pose


def chain_poses(
    design: FingerDesign, joint_angles_rad: Sequence[float], displacements_m: Array
) -> list[tuple[Array, Array, Array]]:
    """Return the poses in ``<finger>_base`` of what the three joints of each flexure move, by `flexure_names`.

    Args:
        design: a finger of n joints.
        joint_angles_rad: (n,), positive when closed.
        displacements_m: (n, 2), along and across.

    Returns:
        n times 3 matrices (4, 4).

    Raises:
        ValueError: another number of angles or displacements.
    """
    if len(joint_angles_rad) != design.joints or displacements_m.shape != (design.joints, 2):
        raise ValueError(
            f"expected {design.joints} joint angles and displacements, found {len(joint_angles_rad)} and "
            f"{displacements_m.shape}"
        )
    poses, end = [], np.eye(4)
    for j, (angle_rad, (along_m, across_m)) in enumerate(zip(joint_angles_rad, displacements_m.tolist(), strict=True)):
        along, across = end @ moved_by(along_m), end @ moved_by(along_m, -across_m)
        link = across @ turned_by(angle_rad)
        poses.append((along, across, link))
        end = link @ moved_by(design.link_lengths_m[j])
    return poses


def link_poses(
    design: FingerDesign, joint_angles_rad: Sequence[float], displacements_m: Array | None = None
) -> list[Array]:
    """Return the pose of each link, then of the tip, in ``<finger>_base``.

    Args:
        design: a finger of n joints.
        joint_angles_rad: (n,), positive when closed.
        displacements_m: (n, 2), along and across; None: hinges.

    Returns:
        n + 1 matrices (4, 4): origin of link j at joint j, x along the link; the last one is the tip.

    Raises:
        ValueError: another number of angles or displacements.
    """
    displaced = np.zeros((design.joints, 2)) if displacements_m is None else displacements_m
    links = [link for _, _, link in chain_poses(design, joint_angles_rad, displaced)]
    return [*links, links[-1] @ moved_by(design.link_lengths_m[-1])]


def quaternion_of(pose: Array) -> tuple[float, float, float, float]:
    """Return a pose's rotation as a unit quaternion (x, y, z, w), w >= 0.

    Shepperd's method: the largest of the four components is computed first, so that no division is by a small number.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = pose[:3, :3].tolist()
    squares = (1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz)
    largest = max(squares)
    rows = (
        (largest, xy + yx, xz + zx, zy - yz),
        (xy + yx, largest, yz + zy, xz - zx),
        (xz + zx, yz + zy, largest, yx - xy),
        (zy - yz, xz - zx, yx - xy, largest),
    )
    row = rows[squares.index(largest)]
    scale = math.copysign(2.0 * math.sqrt(largest), row[3] or 1.0)
    x, y, z, w = (component / scale for component in row)
    return x, y, z, w


def rpy_of(pose: Array) -> tuple[float, float, float]:
    """Return a pose's rotation as roll, pitch, yaw about fixed axes [rad], as URDF's ``rpy``: R = Rz(y) Ry(p) Rx(r)."""
    r = pose[:3, :3]
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if math.hypot(r[0, 0], r[1, 0]) < 1e-12:  # gimbal lock: only roll - yaw is defined
        return math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def rotation_of(rpy_rad: Sequence[float]) -> Array:
    """Return the rotation of roll, pitch, yaw about fixed axes [rad], (3, 3): R = Rz(y) Ry(p) Rx(r)."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in rpy_rad)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip
