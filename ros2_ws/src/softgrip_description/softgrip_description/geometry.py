# SPDX-License-Identifier: Apache-2.0
"""Where every link of a finger is: frames of slots and links as 4x4 matrices.

Frames (docs/conventions.md): ``<finger>_base`` has x along the straight finger from the first joint, closes towards
-y, z completes a right-handed frame. Joint angles grow as the finger closes, so every joint turns about -z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softgrip_description.hand import HandSlot
from softgrip_model.profile import FingerDesign

Array = NDArray[np.float64]


def finger_joint_names(finger: str, joints: int, prefix: str = "") -> list[str]:
    """Return the names of a finger's joints, base to tip."""
    return [f"{prefix}{finger}_joint_{j}" for j in range(joints)]


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


def moved_along_x(distance_m: float) -> Array:
    """Return a shift along x [m], (4, 4)."""
    pose = np.eye(4)
    pose[0, 3] = distance_m
    return pose


def link_poses(design: FingerDesign, joint_angles_rad: Sequence[float]) -> list[Array]:
    """Return the pose of each link, then of the tip, in ``<finger>_base``.

    Args:
        design: a finger of n joints.
        joint_angles_rad: (n,), positive when closed.

    Returns:
        n + 1 matrices (4, 4): origin of link j at joint j, x along the link; the last one is the tip.

    Raises:
        ValueError: another number of angles.
    """
    if len(joint_angles_rad) != design.joints:
        raise ValueError(f"expected {design.joints} joint angles, found {len(joint_angles_rad)}")
    poses, pose = [], np.eye(4)
    for angle_rad, length_m in zip(joint_angles_rad, design.link_lengths_m, strict=True):
        pose = pose @ turned_by(angle_rad)
        poses.append(pose)
        pose = pose @ moved_along_x(length_m)
    return [*poses, pose]


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
