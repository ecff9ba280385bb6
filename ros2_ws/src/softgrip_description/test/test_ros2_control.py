# SPDX-License-Identifier: Apache-2.0
"""The gripper joint and its ros2_control tag, as joint_state_topic_hardware_interface reads them; URDF by MuJoCo."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
import yaml

from softgrip_description import shipped_hand, urdf_of
from softgrip_description.ros2_control import GripperJoint, with_gripper_joint
from softgrip_model.profile import load, shipped_directory

pytest.importorskip("mujoco")
import mujoco

JOINT = GripperJoint("gripper_opening", 0.01, 0.106, 35.0, 0.1, "/a/gripper/joint_states", "/a/gripper/joint_commands")
CONTROLLERS = shipped_directory().parent / "controllers" / "gripper.yaml"


@pytest.fixture
def text() -> str:
    profile = load(shipped_directory() / "power.yaml")
    fingers = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    return with_gripper_joint(urdf_of(shipped_hand(), fingers, prefix="a_"), JOINT, "a_")


def test_the_description_stays_a_sound_urdf_with_one_more_joint(text: str) -> None:
    model = mujoco.MjModel.from_xml_string(text)
    joint = model.joint("gripper_opening")
    assert joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    assert list(joint.range) == pytest.approx([0.01, 0.106])
    assert model.njnt == 25  # three fingers of 3, 3 and 2 flexures, each of which has three


def test_the_hardware_is_the_released_plugin_with_the_cells_topics(text: str) -> None:
    system = ET.fromstring(text).find("ros2_control")
    assert system.get("type") == "system"
    hardware = system.find("hardware")
    assert hardware.find("plugin").text == "joint_state_topic_hardware_interface/JointStateTopicSystem"
    topics = {param.get("name"): param.text for param in hardware.iter("param")}
    assert topics == {
        "joint_states_topic": "/a/gripper/joint_states",
        "joint_commands_topic": "/a/gripper/joint_commands",
        "trigger_joint_command_threshold": "-1",  # always, by its README
    }


def test_the_shipped_controller_claims_interfaces_that_the_joint_has(text: str) -> None:
    """As parallel_gripper_controller does: position commanded, position and velocity read, an effort interface."""
    joint = ET.fromstring(text).find("ros2_control").find("joint")
    commands = {f"{joint.get('name')}/{one.get('name')}" for one in joint.iter("command_interface")}
    states = {one.get("name") for one in joint.iter("state_interface")}
    controller = yaml.safe_load(CONTROLLERS.read_text())["/**/gripper_controller"]["ros__parameters"]
    assert {f"{controller['joint']}/position", controller["max_effort_interface"]} <= commands
    assert {"position", "velocity"} <= states
