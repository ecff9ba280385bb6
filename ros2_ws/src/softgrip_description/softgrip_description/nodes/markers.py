# SPDX-License-Identifier: Apache-2.0
"""hand/markers: cables, measured fingers and contacts as visualization_msgs, for RViz and Foxglove."""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from softgrip_description.geometry import Array
from softgrip_description.overlay import Colour, cable_picture, contact_diameter_m, measured_line_m
from softgrip_description.pose_feed import HandPose
from softgrip_interfaces.msg import FingerState

_CABLE_M, _MEASURED_M = 0.0012, 0.002
_MEASURED: Colour = (0.95, 0.55, 0.10, 1.0)
_CONTACT: Colour = (0.84, 0.19, 0.15, 0.8)


class HandMarkers:
    """The last that is known of each finger, drawn in its base's frame.

    Args:
        pose: what is mounted.
        prefix: before every frame.
    """

    def __init__(self, pose: HandPose, prefix: str) -> None:
        self._pose = pose
        self._prefix = prefix
        self._tensions_n: dict[str, float] = {}
        self._predicted: dict[str, FingerState] = {}
        self._measured: dict[str, FingerState] = {}

    def clear(self) -> None:
        """Forget fingers that were mounted before."""
        self._predicted, self._measured = {}, {}

    def set_tensions(self, tensions_n: dict[str, float]) -> None:
        """Take the measured tension of each tendon [N]."""
        self._tensions_n = tensions_n

    def set_predicted(self, fingers: Sequence[FingerState]) -> None:
        """Take finger/predicted."""
        self._predicted = self._fitting(fingers)

    def set_measured(self, fingers: Sequence[FingerState]) -> None:
        """Take finger/measured."""
        self._measured = self._fitting(fingers)

    def message(self, stamp: Time) -> MarkerArray:
        """Return everything that is to be seen now; what was drawn before goes."""
        markers = [Marker(action=Marker.DELETEALL)]
        for slot, finger in self._predicted.items():
            header = Header(stamp=stamp, frame_id=f"{self._prefix}{slot}_base")
            markers += [self._cable(header, slot, finger), *self._contact(header, slot, finger)]
        for slot, finger in self._measured.items():
            header = Header(stamp=stamp, frame_id=f"{self._prefix}{slot}_base")
            points_m = measured_line_m(self._pose.fingers[slot][1], finger.joint_angles, (finger.tip.x, finger.tip.y))
            markers.append(_marker(header, "measured", slot, Marker.LINE_STRIP, _MEASURED_M, _MEASURED, points_m))
        return MarkerArray(markers=markers)

    def _fitting(self, fingers: Sequence[FingerState]) -> dict[str, FingerState]:
        mounted = self._pose.fingers
        return {
            one.finger: one
            for one in fingers
            if one.finger in mounted
            and len(one.joint_angles) == mounted[one.finger][1].joints
            and all(math.isfinite(value) for value in (*one.joint_angles, one.tip.x, one.tip.y))
        }

    def _cable(self, header: Header, slot: str, finger: FingerState) -> Marker:
        displaced_m = self._pose.displacements_of(slot, finger.joint_angles, (finger.tip.x, finger.tip.y))
        line = cable_picture(self._pose.fingers[slot][1], finger.joint_angles, displaced_m, finger.contact_tensions)
        ends = [at for at in range(len(line.colours)) for _ in range(2)]
        points_m = line.points_m[[at + k % 2 for k, at in enumerate(ends)]]
        marker = _marker(header, "cable", slot, Marker.LINE_LIST, _CABLE_M, (0.0, 0.0, 0.0, 1.0), points_m)
        marker.colors = [_colour(line.colours[at]) for at in ends]
        return marker

    def _contact(self, header: Header, slot: str, finger: FingerState) -> list[Marker]:
        diameter_m = contact_diameter_m(self._tensions_n.get(slot, math.nan), finger.tension)
        if not diameter_m:
            return []
        marker = _marker(header, "contact", slot, Marker.SPHERE, diameter_m, _CONTACT, None)
        marker.pose.position = Point(x=finger.tip.x, y=finger.tip.y, z=0.0)
        return [marker]


def _marker(
    header: Header, kind: str, slot: str, shape: int, size_m: float, colour: Colour, points_m: Array | None
) -> Marker:
    marker = Marker(
        header=header,
        ns=f"{kind}/{slot}",
        id=0,
        type=shape,
        action=Marker.ADD,
        scale=Vector3(x=size_m, y=size_m, z=size_m),
        color=_colour(colour),
        points=[] if points_m is None else [Point(x=x, y=y, z=z) for x, y, z in points_m.tolist()],
    )
    marker.pose.orientation.w = 1.0
    return marker


def _colour(colour: Colour) -> ColorRGBA:
    red, green, blue, alpha = colour
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)
