# SPDX-License-Identifier: Apache-2.0
"""What the hand's pose takes and what it leaves as it was."""

from __future__ import annotations

import math

import pytest

from softgrip_description import HandError, shipped_hand
from softgrip_description.pose_feed import HandPose
from softgrip_model.profile import load_directory, shipped_directory


@pytest.fixture
def pose() -> HandPose:
    pose = HandPose(shipped_hand(), load_directory(shipped_directory()), "a_")
    pose.set_mounted({"index": "power", "thumb": "power"})
    return pose


def test_joint_angles_of_mounted_fingers_are_taken_base_to_tip(pose: HandPose) -> None:
    assert pose.set_joint_angles("thumb", [0.1, 0.2])
    names, angles = pose.joint_state()
    assert names == ["a_index_joint_0", "a_index_joint_1", "a_index_joint_2", "a_thumb_joint_0", "a_thumb_joint_1"]
    assert angles == [0.0, 0.0, 0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ("finger", "angles"),
    [("middle", [0.1, 0.1, 0.1]), ("index", [0.1, 0.1]), ("index", [0.1, math.nan, 0.1]), ("index", [math.inf] * 3)],
)
def test_angles_that_cannot_be_shown_leave_the_last_pose(pose: HandPose, finger: str, angles: list[float]) -> None:
    pose.set_joint_angles("index", [0.3, 0.2, 0.1])
    assert not pose.set_joint_angles(finger, angles)
    assert pose.joint_angles_rad["index"] == (0.3, 0.2, 0.1)


def test_a_swap_starts_straight_and_the_same_fingers_again_change_nothing(pose: HandPose) -> None:
    pose.set_joint_angles("index", [0.3, 0.2, 0.1])
    assert not pose.set_mounted({"index": "power", "thumb": "power"})
    assert pose.joint_angles_rad["index"] == (0.3, 0.2, 0.1)
    assert pose.set_mounted({"index": "hook", "thumb": "hook"})
    assert pose.joint_angles_rad["index"] == (0.0, 0.0, 0.0)


def test_a_refused_mounting_keeps_the_fingers_there_are(pose: HandPose) -> None:
    with pytest.raises(HandError, match="expected one of"):
        pose.set_mounted({"index": "velcro"})
    assert set(pose.fingers) == {"index", "thumb"}
