# SPDX-License-Identifier: Apache-2.0
"""What the hand's pose takes and what it leaves as it was."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softgrip_description import HandError, shipped_hand
from softgrip_description.pose_feed import HandPose
from softgrip_model.profile import load_directory, shipped_directory


@pytest.fixture
def pose() -> HandPose:
    pose = HandPose(shipped_hand(), load_directory(shipped_directory()), "a_")
    pose.set_mounted({"index": "power", "thumb": "power"})
    return pose


def hinged_tip(pose: HandPose, finger: str, angles: list[float]) -> np.ndarray:
    """The tip of rigid links."""
    tip = np.exp(-1j * np.cumsum(angles)) @ pose.fingers[finger][1].link_lengths_m
    return np.array([tip.real, tip.imag])


def test_joints_of_mounted_fingers_are_named_and_placed_base_to_tip(pose: HandPose) -> None:
    tip = hinged_tip(pose, "thumb", [0.1, 0.2]) + np.array([0.0002, -0.0004])
    assert pose.set_finger("thumb", [0.1, 0.2], tip)
    joints = dict(zip(*pose.joint_state(), strict=True))
    turning = ["a_index_joint_0", "a_index_joint_1", "a_index_joint_2", "a_thumb_joint_0", "a_thumb_joint_1"]
    assert list(joints) == [name + suffix for name in turning for suffix in ("_along", "_across", "")]
    assert [joints[name] for name in turning] == [0.0, 0.0, 0.0, 0.1, 0.2]
    assert joints["a_index_joint_1_along"] == joints["a_index_joint_1_across"] == 0.0
    # the displacement of joint 1 is seen from the link before it, which has turned by 0.1 rad
    first, second = (
        np.array([joints[f"a_thumb_joint_{j}_along"], joints[f"a_thumb_joint_{j}_across"]]) for j in (0, 1)
    )
    turned = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]) @ second
    assert first + turned == pytest.approx([0.0002, 0.0004])


def test_every_link_of_a_finger_has_a_frame(pose: HandPose) -> None:
    angles = [0.1, 0.2]
    pose.set_finger("thumb", angles, hinged_tip(pose, "thumb", angles) + np.array([0.0002, -0.0004]))
    frames = {child: (parent, at) for parent, child, at in pose.link_transforms()}
    names = [f"a_thumb_link_{j}{suffix}" for j in (0, 1) for suffix in ("_along", "_across", "")]
    assert [name for name in frames if "thumb" in name] == names
    assert {frames[name][0] for name in names} == {"a_thumb_base"}
    joints = dict(zip(*pose.joint_state(), strict=True))
    moved = frames["a_thumb_link_0_across"][1] - frames["a_thumb_link_0_along"][1]
    assert moved[:2, 3] == pytest.approx([0.0, -joints["a_thumb_joint_0_across"]], abs=1e-12)


@pytest.mark.parametrize(
    ("finger", "angles"),
    [("middle", [0.1, 0.1, 0.1]), ("index", [0.1, 0.1]), ("index", [0.1, math.nan, 0.1]), ("index", [math.inf] * 3)],
)
def test_angles_that_cannot_be_shown_leave_the_last_pose(pose: HandPose, finger: str, angles: list[float]) -> None:
    pose.set_finger("index", [0.3, 0.2, 0.1], (0.09, -0.03))
    assert not pose.set_finger(finger, angles, (0.09, -0.03))
    assert pose.joint_angles_rad["index"] == (0.3, 0.2, 0.1)


def test_a_swap_starts_straight_and_the_same_fingers_again_change_nothing(pose: HandPose) -> None:
    pose.set_finger("index", [0.3, 0.2, 0.1], hinged_tip(pose, "index", [0.3, 0.2, 0.1]) + 0.001)
    assert not pose.set_mounted({"index": "power", "thumb": "power"})
    assert pose.joint_angles_rad["index"] == (0.3, 0.2, 0.1)
    assert pose.set_mounted({"index": "hook", "thumb": "hook"})
    assert pose.joint_angles_rad["index"] == (0.0, 0.0, 0.0)
    assert not pose.displacements_m["index"].any()


def test_a_refused_mounting_keeps_the_fingers_there_are(pose: HandPose) -> None:
    with pytest.raises(HandError, match="expected one of"):
        pose.set_mounted({"index": "velcro"})
    assert set(pose.fingers) == {"index", "thumb"}
