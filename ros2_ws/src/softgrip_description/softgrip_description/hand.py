# SPDX-License-Identifier: Apache-2.0
"""A hand file (data/hand.schema.json) as frozen values: strict reading, every problem named at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from softgrip_description.checked_yaml import FileKind
from softgrip_description.errors import HandError
from softgrip_model.profile import FingerDesign

_KIND = FileKind("hand", HandError, "copy the shipped one, softgrip_description/data/hand.yaml")
_SHIPPED = Path(__file__).parent / "data" / "hand.yaml"

Point = tuple[float, float, float]


@dataclass(frozen=True)
class HandSlot:
    """Where a finger starts, in the frame `palm`.

    Attributes:
        position_m: of the finger's first joint.
        rest_angle_rad: between the palm's surface and the straight finger.
        closes_towards_x: the finger closes towards +x (+1) or -x (-1).
        max_length_m: of a finger from its first joint to its tip; a longer one would not clear the table.
    """

    position_m: Point
    rest_angle_rad: float
    closes_towards_x: int
    max_length_m: float


@dataclass(frozen=True)
class Hand:
    """Palm, slots and tool centre points; see data/hand.yaml for the frames.

    Attributes:
        name: of the hand, used for the robot's name.
        flange_position_m, flange_rpy_rad: pose of `palm` in `flange`; roll, pitch, yaw about fixed axes, as in URDF.
        palm_size_m: x, y, z.
        palm_mass_kg: of palm and drives.
        slots: by name.
        tool_centre_points_m: by finger set, in `palm`.
        default_tool_centre_point_m: of any other finger set.
        finger_density_kg_m3: of the printed fingers.
    """

    name: str
    flange_position_m: Point
    flange_rpy_rad: Point
    palm_size_m: Point
    palm_mass_kg: float
    slots: Mapping[str, HandSlot]
    tool_centre_points_m: Mapping[str, Point]
    default_tool_centre_point_m: Point
    finger_density_kg_m3: float

    def tool_centre_point_m(self, finger_set: str) -> Point:
        """Return the tool centre point of a finger set in the frame `palm` [m]."""
        return self.tool_centre_points_m.get(finger_set, self.default_tool_centre_point_m)

    def check_mounting(self, fingers: Mapping[str, FingerDesign]) -> None:
        """Raise HandError unless every finger has its slot and fits it."""
        problems = []
        for slot, design in fingers.items():
            if slot not in self.slots:
                problems.append(f"slot {slot!r}: expected one of {', '.join(self.slots)}; name the finger's slot so")
            elif design.length_m > self.slots[slot].max_length_m:
                problems.append(
                    f"slot {slot!r}: expected a finger of at most {1e3 * self.slots[slot].max_length_m:g} mm, found "
                    f"{1e3 * design.length_m:g} mm; shorten its links or give the slot a larger max_length_m"
                )
        if problems:
            raise HandError("; ".join(problems))


@cache
def shipped_hand() -> Hand:
    """Return the hand that this package ships."""
    return load_hand(_SHIPPED)


def load_hand(path: Path) -> Hand:
    """Read and check a hand file.

    Raises:
        HandError: the file cannot be read, is not YAML, or does not describe a hand; names every problem with its line.
    """
    document = _KIND.parse(_KIND.read(path), path)
    _KIND.check(document, path)
    data = document.value
    return Hand(
        name=data["name"],
        flange_position_m=_point(data["flange"]["position_m"]),
        flange_rpy_rad=_point(data["flange"]["rpy_rad"]),
        palm_size_m=_point(data["palm"]["size_m"]),
        palm_mass_kg=float(data["palm"]["mass_kg"]),
        slots={name: _slot(row) for name, row in data["slots"].items()},
        tool_centre_points_m={name: _point(row) for name, row in data["tool_centre_points_m"].items()},
        default_tool_centre_point_m=_point(data["default_tool_centre_point_m"]),
        finger_density_kg_m3=float(data["finger_density_kg_m3"]),
    )


def _slot(row: Mapping[str, Any]) -> HandSlot:
    return HandSlot(
        position_m=_point(row["position_m"]),
        rest_angle_rad=float(row["rest_angle_rad"]),
        closes_towards_x=int(row["closes_towards_x"]),
        max_length_m=float(row["max_length_m"]),
    )


def _point(values: Sequence[float]) -> Point:
    x, y, z = map(float, values)
    return x, y, z
