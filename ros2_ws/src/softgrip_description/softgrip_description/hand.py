# SPDX-License-Identifier: Apache-2.0
"""A hand file (schema 1) as frozen values: strict reading, every problem named at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from softgrip_description.errors import HandError
from softgrip_model.profile import FingerDesign

SCHEMA = 1
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
        HandError: the file cannot be read, is not YAML, or does not describe a hand; names every problem.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise HandError(f"{path}: cannot be read as a hand file: {error}") from error
    reader = _HandReader()
    hand = reader.read_hand(data)
    if hand is None or reader.problems:
        raise HandError(f"{path}: " + "; ".join(reader.problems))
    return hand


class _HandReader:
    """Collects every problem of a document, so that its author sees all of them at once."""

    def __init__(self) -> None:
        self.problems: list[str] = []

    def read_hand(self, data: Any) -> Hand | None:
        """Return the hand, or None where the document has another form; see `problems` in both cases."""
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            found = data.get("schema") if isinstance(data, dict) else type(data).__name__
            self.problems.append(f"schema: expected a mapping with 'schema: {SCHEMA}', found {found!r}")
            return None
        self._check_keys("", data, {
            "schema", "name", "flange", "palm", "slots", "tool_centre_points_m", "default_tool_centre_point_m",
            "finger_density_kg_m3",
        })  # fmt: skip
        flange = self._mapping("flange", data.get("flange"), {"position_m", "rpy_rad"})
        palm = self._mapping("palm", data.get("palm"), {"size_m", "mass_kg"})
        slots = self._mapping("slots", data.get("slots"))
        points = self._mapping("tool_centre_points_m", data.get("tool_centre_points_m"))
        if not slots:
            self.problems.append("slots: expected at least one, found none")
        return Hand(
            name=self._name("name", data.get("name")),
            flange_position_m=self._point("flange.position_m", flange.get("position_m")),
            flange_rpy_rad=self._point("flange.rpy_rad", flange.get("rpy_rad")),
            palm_size_m=self._point("palm.size_m", palm.get("size_m"), positive=True),
            palm_mass_kg=self._number("palm.mass_kg", palm.get("mass_kg")),
            slots={self._name("slots", name): self._slot(f"slots.{name}", row) for name, row in slots.items()},
            tool_centre_points_m={
                self._name("tool_centre_points_m", name): self._point(f"tool_centre_points_m.{name}", row)
                for name, row in points.items()
            },
            default_tool_centre_point_m=self._point(
                "default_tool_centre_point_m", data.get("default_tool_centre_point_m")
            ),
            finger_density_kg_m3=self._number("finger_density_kg_m3", data.get("finger_density_kg_m3")),
        )

    def _slot(self, where: str, row: Any) -> HandSlot:
        row = self._mapping(where, row, {"position_m", "rest_angle_rad", "closes_towards_x", "max_length_m"})
        side = row.get("closes_towards_x")
        if side not in {-1, 1} or isinstance(side, bool):
            self.problems.append(f"{where}.closes_towards_x: expected 1 or -1, found {side!r}")
            side = 1
        angle = self._number(f"{where}.rest_angle_rad", row.get("rest_angle_rad"), minimum=-math.pi)
        if angle > math.pi:
            self.problems.append(f"{where}.rest_angle_rad: expected -pi to pi rad, found {angle!r}")
        return HandSlot(
            self._point(f"{where}.position_m", row.get("position_m")),
            angle,
            int(side),
            self._number(f"{where}.max_length_m", row.get("max_length_m")),
        )

    def _mapping(self, where: str, value: Any, keys: set[str] | None = None) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.problems.append(f"{where}: expected a mapping, found {type(value).__name__}")
            return {}
        if keys is not None:
            self._check_keys(f"{where}.", value, keys)
        return value

    def _check_keys(self, where: str, value: dict[str, Any], keys: set[str]) -> None:
        for key in sorted(keys - set(value)):
            self.problems.append(f"{where}{key}: missing")
        for key in sorted(map(str, set(value) - keys)):
            self.problems.append(f"{where}{key}: unknown; expected {', '.join(sorted(keys))}")

    def _name(self, where: str, value: Any) -> str:
        if not isinstance(value, str) or not value or not all(c.isalnum() or c == "_" for c in value):
            self.problems.append(f"{where}: expected a name of letters, digits and _, found {value!r}")
            return "unnamed"
        return value

    def _number(self, where: str, value: Any, minimum: float = 0.0) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not minimum < value < math.inf:
            self.problems.append(f"{where}: expected a number above {minimum:g}, found {value!r}")
            return 1.0
        return float(value)

    def _point(self, where: str, value: Any, *, positive: bool = False) -> Point:
        lowest = 0.0 if positive else -math.inf
        numbers = isinstance(value, list) and len(value) == 3 and all(
            isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one) and one > lowest
            for one in value
        )  # fmt: skip
        if not numbers:
            self.problems.append(f"{where}: expected three {'positive ' if positive else ''}numbers, found {value!r}")
            return (1.0, 1.0, 1.0)
        return (float(value[0]), float(value[1]), float(value[2]))
