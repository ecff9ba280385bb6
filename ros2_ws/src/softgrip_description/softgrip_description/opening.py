# SPDX-License-Identifier: Apache-2.0
"""The hand seen as a parallel gripper: opening at the tool centre point over the pulled length of its tendons.

A standard gripper action knows one number: the opening [m]. Here it is the distance along x of the palm, at the height
of the tool centre point, between the joints' line of the thumb and that of the foremost finger opposite, less the depth
of both bodies. It is that of the empty closing of the finger kernel. All tendons are pulled by the same length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from softgrip_description.errors import HandError
from softgrip_description.flexures import FingerFlexures
from softgrip_description.geometry import link_poses, slot_pose
from softgrip_description.hand import Hand, HandSlot
from softgrip_description.urdf import finger_set_of
from softgrip_model.finger import Finger, Kernel
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.profile import FingerDesign, Profile

Array = NDArray[np.float64]

#: Spacing of the tabulated closing [m]; between two entries the clearance is linear to a few micrometres.
_STEP_M = 0.00025
#: Longest pulled length that is tabulated [m].
_MAX_PULLED_M = 0.030


@dataclass(frozen=True, eq=False)
class FingerClearance:
    """How far a finger's inner face stays from the tool centre point while it closes without contact.

    Attributes:
        closes_towards_x: of its slot.
        pulled_length_m: (k,), from 0, ascending.
        clearance_m: (k,), along x at the height of the tool centre point, falling; negative past that point.
    """

    closes_towards_x: int
    pulled_length_m: Array
    clearance_m: Array

    def at(self, pulled_length_m: float) -> float:
        """Return the clearance [m]; beyond the table that of its end."""
        return float(np.interp(pulled_length_m, self.pulled_length_m, self.clearance_m))

    def slope_at(self, pulled_length_m: float) -> float:
        """Return the change of clearance per pulled length (negative), 0 outside the table."""
        if not 0.0 <= pulled_length_m <= self.pulled_length_m[-1]:
            return 0.0
        k = min(int(np.searchsorted(self.pulled_length_m, pulled_length_m, "right")), len(self.pulled_length_m) - 1)
        rise = self.clearance_m[k] - self.clearance_m[k - 1]
        return float(rise / (self.pulled_length_m[k] - self.pulled_length_m[k - 1]))


class GripperOpening:
    """Opening of a mounted hand over pulled lengths, both ways.

    Args:
        clearances: slot -> table; one side has at least one finger, and so has the other.

    Raises:
        HandError: no finger on one side, so that there is no opening.
    """

    def __init__(self, clearances: Mapping[str, FingerClearance]) -> None:
        self.clearances = dict(clearances)
        sides = {side: [s for s, one in clearances.items() if one.closes_towards_x == side] for side in (-1, 1)}
        if not all(sides.values()):
            raise HandError(
                f"opening: expected a finger on each side of the tool centre point, found {sorted(clearances)}; mount "
                "the thumb and a finger opposite"
            )
        self._sides = tuple(sides.values())
        end_m = min(one.pulled_length_m[-1] for one in clearances.values())
        self._pulled_length_m = np.linspace(0.0, end_m, round(end_m / _STEP_M) + 1)
        openings = np.array([self.opening_m(dict.fromkeys(clearances, u)) for u in self._pulled_length_m])
        closed = int(np.argmax(openings <= 0.0)) if (openings <= 0.0).any() else len(openings) - 1
        self._pulled_length_m, self._openings_m = self._pulled_length_m[: closed + 1], openings[: closed + 1]

    @property
    def max_m(self) -> float:
        """Opening of the open hand [m]."""
        return float(self._openings_m[0])

    @property
    def min_m(self) -> float:
        """Smallest opening that a goal can ask for [m]."""
        return float(self._openings_m[-1])

    def opening_m(self, pulled_lengths_m: Mapping[str, float]) -> float:
        """Return the opening at pulled lengths [m] (slot -> pulled length), never below 0."""
        return max(0.0, sum(min(self.clearances[s].at(pulled_lengths_m[s]) for s in side) for side in self._sides))

    def velocity_m_s(self, pulled_lengths_m: Mapping[str, float], speeds_m_s: Mapping[str, float]) -> float:
        """Return the speed of the opening, + opens, from pulled lengths [m] and their speeds [m/s]."""
        total = 0.0
        for side in self._sides:
            foremost = min(side, key=lambda s: self.clearances[s].at(pulled_lengths_m[s]))
            total += self.clearances[foremost].slope_at(pulled_lengths_m[foremost]) * speeds_m_s[foremost]
        return total

    def pulled_length_m(self, opening_m: float) -> float:
        """Return the pulled length of all tendons that gives an opening [m]; the nearest one outside the range."""
        return float(np.interp(-opening_m, -self._openings_m, self._pulled_length_m))

    def tendon_speed_m_s(self, opening_speed_m_s: float) -> float:
        """Return the speed of the tendons [m/s] at which no part of the way is faster than an opening's speed [m/s]."""
        steepest = float(np.max(-np.diff(self._openings_m) / np.diff(self._pulled_length_m)))
        return opening_speed_m_s / steepest


def gripper_opening(hand: Hand, profiles: Mapping[str, Profile], mounted: Mapping[str, str]) -> GripperOpening:
    """Return the opening of a mounted hand, from the empty closing of each finger with its profile's own friction.

    Args:
        hand: palm, slots and tool centre points.
        profiles: by id.
        mounted: slot -> profile id, of the slots that hold a finger.

    Raises:
        HandError: a finger without a slot, or none on one side.
    """
    designs = {slot: profiles[profile].finger(slot) for slot, profile in mounted.items()}
    hand.check_mounting(designs)
    finger_set = finger_set_of({slot: (mounted[slot], design) for slot, design in designs.items()})
    point = np.array(hand.tool_centre_point_m(finger_set))
    return GripperOpening({
        slot: _clearance(hand.slots[slot], profiles[mounted[slot]], slot, point) for slot in designs
    })  # fmt: skip


def _clearance(slot: HandSlot, profile: Profile, name: str, point: Array) -> FingerClearance:
    """Tabulate one finger until its inner face leaves the height of the point, or its closing ends."""
    design, flexures = profile.finger(name), FingerFlexures(profile, name)
    pulled_length_m = np.linspace(0.0, _MAX_PULLED_M, round(_MAX_PULLED_M / _STEP_M) + 1)
    kernel = Kernel([Finger.from_profile(profile, name)], assumed_friction(profile).law)
    solution = kernel.solve(1e3 * pulled_length_m)
    clearances: list[float] = []
    for angles, tip_mm, failed in zip(solution.angle_rad[0], solution.tip_mm[0], solution.failed[0], strict=True):
        poses = [] if failed else link_poses(design, angles, flexures.displacements_m(angles, 1e-3 * tip_mm))
        clearance = _clearance_at(slot, design, poses, point)
        if clearance is None or (clearances and clearance >= clearances[-1]):
            break
        clearances.append(clearance)
    if len(clearances) < 2:
        raise HandError(
            f"slot {name!r}: expected a finger that crosses the height of the tool centre point ({1e3 * point[2]:g} mm "
            "over the palm), found none; correct tool_centre_points_m of the hand file"
        )
    return FingerClearance(slot.closes_towards_x, pulled_length_m[: len(clearances)], np.array(clearances))


def _clearance_at(slot: HandSlot, design: FingerDesign, poses: Sequence[Array], point: Array) -> float | None:
    """Return how far the inner face of a finger with these link poses stays from the point along x at its height [m].

    None where the joints' line does not cross that height exactly once: below it, or folded back over it.
    """
    base = slot_pose(slot)
    nodes = np.array([(base @ pose)[:3, 3] for pose in poses])
    crossings = []
    for (x0, _, z0), (x1, _, z1) in pairwise(nodes):
        if min(z0, z1) <= point[2] < max(z0, z1):
            crossings.append(x0 + (point[2] - z0) / (z1 - z0) * (x1 - x0))
    if len(crossings) != 1:
        return None
    return float(-slot.closes_towards_x * (crossings[0] - point[0])) - design.body_height_m
