# SPDX-License-Identifier: Apache-2.0
"""The hand as a one-joint gripper for ros2_control, through topics: a prismatic joint and a ``ros2_control`` tag.

joint_state_topic_hardware_interface (released for Jazzy) is the hardware; it needs no code of ours. Source of the tag:
README.md of joint_state_topic_hardware_interface in ros-controls/topic_based_hardware_interfaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

from softgrip_description.urdf import add_small_mass

_PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"


@dataclass(frozen=True)
class GripperJoint:
    """The one joint that stands for the opening.

    Attributes:
        name: of the joint.
        min_m, max_m: range of the opening.
        effort_n: largest tendon tension.
        velocity_m_s: fastest change.
        states_topic, commands_topic: of gripper_command, absolute.
    """

    name: str
    min_m: float
    max_m: float
    effort_n: float
    velocity_m_s: float
    states_topic: str
    commands_topic: str


def with_gripper_joint(urdf: str, joint: GripperJoint, prefix: str = "") -> str:
    """Return a hand's URDF with the gripper joint and its ``ros2_control`` tag.

    The child of the joint is a link without a shape at the tool centre point: nothing of the fingers hangs on it.

    Args:
        urdf: of `urdf_of`.
        joint: range and topics.
        prefix: the URDF's own.
    """
    robot = ET.fromstring(urdf)  # noqa: S314  our own text
    link = f"{prefix}opening"
    add_small_mass(ET.SubElement(robot, "link", name=link))
    element = ET.SubElement(robot, "joint", name=joint.name, type="prismatic")
    ET.SubElement(element, "parent", link=f"{prefix}tcp")
    ET.SubElement(element, "child", link=link)
    ET.SubElement(element, "axis", xyz="1 0 0")
    ET.SubElement(
        element,
        "limit",
        lower=f"{joint.min_m:.6g}",
        upper=f"{joint.max_m:.6g}",
        effort=f"{joint.effort_n:.6g}",
        velocity=f"{joint.velocity_m_s:.6g}",
    )
    system = ET.SubElement(robot, "ros2_control", name=f"{prefix}softgrip", type="system")
    hardware = ET.SubElement(system, "hardware")
    ET.SubElement(hardware, "plugin").text = _PLUGIN
    ET.SubElement(hardware, "param", name="joint_states_topic").text = joint.states_topic
    ET.SubElement(hardware, "param", name="joint_commands_topic").text = joint.commands_topic
    # every cycle: gripper_command learns where a controller begins before its first goal
    ET.SubElement(hardware, "param", name="trigger_joint_command_threshold").text = "-1"
    controlled = ET.SubElement(system, "joint", name=joint.name)
    for name in ("position", "effort"):
        ET.SubElement(controlled, "command_interface", name=name)
    for name in ("position", "velocity", "effort"):
        ET.SubElement(controlled, "state_interface", name=name)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"
