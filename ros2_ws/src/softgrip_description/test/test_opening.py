# SPDX-License-Identifier: Apache-2.0
"""The opening at the tool centre point, of every shipped finger set and of a hand whose opening has a closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from softgrip_description import HandError, shipped_hand
from softgrip_description.opening import FingerClearance, GripperOpening, gripper_opening
from softgrip_model.profile import Profile, load_directory, shipped_directory

SETS = ("power", "pinch", "hook")


@pytest.fixture(scope="module")
def profiles() -> dict[str, Profile]:
    return load_directory(shipped_directory())


def mounted(profiles: dict[str, Profile], finger_set: str) -> dict[str, str]:
    return dict.fromkeys(profiles[finger_set].slots, finger_set)


@pytest.mark.parametrize("finger_set", SETS)
def test_straight_fingers_are_as_far_apart_as_a_drawing_says(profiles: dict[str, Profile], finger_set: str) -> None:
    """Straight fingers leave their slots at the rest angle: at height z they stand z / tan(angle) further out."""
    hand, opening = shipped_hand(), gripper_opening(shipped_hand(), profiles, mounted(profiles, finger_set))
    height_m, at_x_m = (hand.tool_centre_points_m[finger_set][axis] for axis in (2, 0))

    def clearance_m(name: str) -> float:
        slot = hand.slots[name]
        out = (height_m - slot.position_m[2]) / math.tan(slot.rest_angle_rad)
        x = slot.position_m[0] - slot.closes_towards_x * out
        return -slot.closes_towards_x * (x - at_x_m) - profiles[finger_set].finger(name).body_height_m

    expected = clearance_m("thumb") + min(clearance_m("index"), clearance_m("middle"))
    assert opening.max_m == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("finger_set", SETS)
def test_pulling_closes_and_a_goal_comes_back_as_it_was_asked_for(
    profiles: dict[str, Profile], finger_set: str
) -> None:
    opening = gripper_opening(shipped_hand(), profiles, mounted(profiles, finger_set))
    goals = np.linspace(opening.max_m, opening.min_m, 50)
    pulled = [opening.pulled_length_m(goal) for goal in goals]
    assert pulled[0] == 0.0
    assert np.all(np.diff(pulled) > 0.0)
    for goal, length in zip(goals, pulled, strict=True):
        assert opening.opening_m(dict.fromkeys(opening.clearances, length)) == pytest.approx(goal, abs=1e-4)


@pytest.mark.parametrize("finger_set", SETS)
def test_the_speed_of_the_opening_is_its_difference_quotient(profiles: dict[str, Profile], finger_set: str) -> None:
    opening = gripper_opening(shipped_hand(), profiles, mounted(profiles, finger_set))
    step, speed = 1e-7, 0.01
    for length in np.linspace(0.0003, opening.pulled_length_m(opening.min_m) - 0.0004, 20):
        at, further = (dict.fromkeys(opening.clearances, length + by) for by in (0.0, step))
        slope = (opening.opening_m(further) - opening.opening_m(at)) / step
        found = opening.velocity_m_s(at, dict.fromkeys(opening.clearances, speed))
        assert found == pytest.approx(slope * speed, rel=1e-4)


@pytest.mark.parametrize("finger_set", SETS)
def test_no_part_of_the_way_is_faster_than_asked_for(profiles: dict[str, Profile], finger_set: str) -> None:
    opening = gripper_opening(shipped_hand(), profiles, mounted(profiles, finger_set))
    tendon_speed = opening.tendon_speed_m_s(0.05)
    speeds = [
        abs(opening.velocity_m_s(dict.fromkeys(opening.clearances, u), dict.fromkeys(opening.clearances, tendon_speed)))
        for u in np.linspace(0.0001, opening.pulled_length_m(opening.min_m) - 0.0001, 200)
    ]
    # the last quarter of a millimetre, between two places of the table, is the steepest of some sets
    assert 0.99 * 0.05 < max(speeds) < 1.001 * 0.05


def straight(side: int, clearance_m: float, slope: float = 1.0) -> FingerClearance:
    """A finger whose face moves by `slope` metres per metre pulled."""
    pulled = np.linspace(0.0, 0.02, 81)
    return FingerClearance(side, pulled, clearance_m - slope * pulled)


def test_the_foremost_finger_counts() -> None:
    opening = GripperOpening({"a": straight(-1, 0.030), "b": straight(-1, 0.025), "thumb": straight(1, 0.020, 2.0)})
    assert opening.max_m == pytest.approx(0.045)
    assert opening.min_m == pytest.approx(0.0, abs=1e-3)
    assert opening.opening_m({"a": 0.012, "b": 0.002, "thumb": 0.003}) == pytest.approx(0.018 + 0.014)
    assert opening.velocity_m_s({"a": 0.012, "b": 0.002, "thumb": 0.003}, {"a": 0.1, "b": 9.0, "thumb": 0.2}) == (
        pytest.approx(-0.5)
    )


def test_a_hand_without_a_thumb_has_no_opening(profiles: dict[str, Profile]) -> None:
    with pytest.raises(HandError, match="expected a finger on each side"):
        gripper_opening(shipped_hand(), profiles, {"index": "power", "middle": "power"})


def test_a_point_that_no_finger_reaches_is_named(profiles: dict[str, Profile]) -> None:
    hand = replace(shipped_hand(), tool_centre_points_m={"power": (0.0, 0.0, 0.300)})
    with pytest.raises(HandError, match="300 mm over the palm"):
        gripper_opening(hand, profiles, mounted(profiles, "power"))


def test_a_finger_too_long_for_its_slot_is_refused(profiles: dict[str, Profile]) -> None:
    slots = {name: replace(slot, max_length_m=0.05) for name, slot in shipped_hand().slots.items()}
    with pytest.raises(HandError, match="at most 50 mm"):
        gripper_opening(replace(shipped_hand(), slots=slots), profiles, mounted(profiles, "power"))
