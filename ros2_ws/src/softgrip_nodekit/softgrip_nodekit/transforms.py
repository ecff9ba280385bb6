# SPDX-License-Identifier: Apache-2.0
"""Poses as tf takes them."""

from __future__ import annotations

from collections.abc import Iterable

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header


def transform_message(
    stamp: Time, parent: str, child: str, position_m: Iterable[float], quaternion: Iterable[float]
) -> TransformStamped:
    """Return where a frame lies in its parent: position (3,) [m], and a unit quaternion (x, y, z, w)."""
    x, y, z = (float(value) for value in position_m)
    qx, qy, qz, qw = (float(value) for value in quaternion)
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
    )
