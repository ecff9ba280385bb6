# SPDX-License-Identifier: Apache-2.0
"""hand_description as a process: description, joint states and tf follow what is mounted and predicted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from softgrip_description import link_poses, shipped_hand, slot_pose
from softgrip_description.nodes.hand_description import StatePublisherLink
from softgrip_interfaces.msg import CellState, FingerState, FingerStates, MountedFinger
from softgrip_model.profile import load, shipped_directory
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, to_time_message
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.node_processes import Peer, node_processes, peer_node

pytest.importorskip("mujoco")
import mujoco

pytestmark = pytest.mark.ros
SLOTS = ("index", "middle", "thumb")


@pytest.fixture
def peer() -> Iterator[Peer]:
    os.environ["ROS_DOMAIN_ID"] = own_domain()
    with peer_node("viewer") as node, node_processes("softgrip_description.nodes.hand_description") as start:
        node.start = start
        yield node


def matrix(transform) -> np.ndarray:
    """(4, 4) of a TransformStamped, the rotation by MuJoCo."""
    pose, flat = np.eye(4), np.zeros(9)
    rotation, shift = transform.transform.rotation, transform.transform.translation
    mujoco.mju_quat2Mat(flat, np.array([rotation.w, rotation.x, rotation.y, rotation.z]))
    pose[:3, :3], pose[:3, 3] = flat.reshape(3, 3), (shift.x, shift.y, shift.z)
    return pose


def chain(transforms: dict, frame: str, root: str) -> np.ndarray:
    """Compose tf from a frame up to the root, as tf2 does."""
    pose = np.eye(4)
    while frame != root:
        transform = transforms[frame]
        pose, frame = matrix(transform) @ pose, transform.header.frame_id
    return pose


def cell_state(profile: str) -> CellState:
    return CellState(mounted=[MountedFinger(finger=slot, serial="x", profile=profile, state=3) for slot in SLOTS])


def tip(profile: str, slot: str, angle_rad: float) -> np.ndarray:
    """(4, 4) in the finger's base: a millimetre beyond that of rigid links."""
    design = load(shipped_directory() / f"{profile}.yaml").finger(slot)
    pose = link_poses(design, [angle_rad] * design.joints)[-1].copy()
    pose[:2, 3] += (0.0008, -0.0006)
    return pose


def predicted(profile: str, angle_rad: float) -> FingerStates:
    fingers = []
    for slot in SLOTS:
        x, y, _ = tip(profile, slot, angle_rad)[:3, 3].tolist()
        joints = load(shipped_directory() / f"{profile}.yaml").finger(slot).joints
        fingers.append(
            FingerState(finger=slot, profile=profile, joint_angles=[angle_rad] * joints, tip=Point(x=x, y=y, z=0.0))
        )
    return FingerStates(header=Header(stamp=to_time_message(1_000_000_000)), fingers=fingers)


def test_tf_and_description_follow_a_swap_and_a_closing(peer: Peer) -> None:
    descriptions = peer.hear(String, "robot_description", LATCHED)
    moving, fixed = peer.hear(TFMessage, "/tf", RELIABLE), peer.hear(TFMessage, "/tf_static", LATCHED)
    joints = peer.hear(JointState, "joint_states", RELIABLE)
    cell = peer.node.create_publisher(CellState, "cell/state", LATCHED)
    fingers = peer.node.create_publisher(FingerStates, "finger/predicted", SENSOR)
    peer.start()
    peer.spin_until(lambda: descriptions and fixed)
    before = descriptions[-1].data
    cell.publish(cell_state("hook"))
    peer.spin_until(lambda: descriptions[-1].data != before and len(fixed) > 1)

    def published() -> bool:
        fingers.publish(predicted("hook", 0.3))
        return bool(moving and joints)

    peer.spin_until(published)
    transforms = {t.child_frame_id: t for message in [*fixed, *moving] for t in message.transforms}
    hand = shipped_hand()
    for slot in SLOTS:
        expected = slot_pose(hand.slots[slot]) @ tip("hook", slot, 0.3)
        assert chain(transforms, f"{slot}_tip", "palm") == pytest.approx(expected, abs=1e-9)
    assert chain(transforms, "tcp", "palm")[:3, 3] == pytest.approx(hand.tool_centre_points_m["hook"])
    assert chain(transforms, "tcp", "flange")[2, 3] == pytest.approx(
        hand.flange_position_m[2] + hand.tool_centre_points_m["hook"][2]
    )
    assert joints[-1].header.stamp.sec == 1
    model = mujoco.MjModel.from_xml_string(descriptions[-1].data)
    assert list(joints[-1].name) == [model.joint(i).name for i in range(model.njnt)]
    turned = [at for name, at in zip(joints[-1].name, joints[-1].position, strict=True) if name[-1].isdigit()]
    assert set(turned) == {0.3}
    links = [link.get("name") for link in ET.fromstring(descriptions[-1].data).iter("link")]
    assert set(links) == {*transforms, "flange"}  # RViz warns of every link without a frame


def test_cables_measured_fingers_and_contacts_are_drawn_in_the_fingers_frames(peer: Peer) -> None:
    pictures = peer.hear(MarkerArray, "hand/markers", SENSOR)
    cell = peer.node.create_publisher(CellState, "cell/state", LATCHED)
    expected = peer.node.create_publisher(FingerStates, "finger/predicted", SENSOR)
    measured = peer.node.create_publisher(FingerStates, "finger/measured", SENSOR)
    tendons = peer.node.create_publisher(JointState, "tendon/state", SENSOR)
    peer.start("marker_rate_hz:=20.0", "frame_prefix:=a_")
    message = predicted("power", 0.3)
    for finger in message.fingers:
        finger.tension = 4.0
        finger.contact_tensions = np.linspace(4.0, 1.0, 2 * len(finger.joint_angles) + 1).tolist()
    seen = predicted("power", 0.25)
    seen.fingers = seen.fingers[:1]

    def drawn() -> dict[str, Marker]:
        expected.publish(message)
        measured.publish(seen)
        tendons.publish(JointState(name=list(SLOTS), position=[0.01] * 3, effort=[4.2, 10.0, 4.1]))
        return {one.ns: one for one in pictures[-1].markers} if pictures else {}

    full = {"", "cable/index", "cable/middle", "cable/thumb", "contact/middle", "measured/index"}
    peer.spin_until(lambda: set(drawn()) == full)
    markers = drawn()
    assert pictures[-1].markers[0].action == Marker.DELETEALL  # what is no longer there goes
    cable, contact, finger = markers["cable/index"], markers["contact/middle"], markers["measured/index"]
    assert {cable.header.frame_id, finger.header.frame_id} == {"a_index_base"}
    assert (cable.type, finger.type, contact.type) == (Marker.LINE_LIST, Marker.LINE_STRIP, Marker.SPHERE)
    assert len(cable.points) == len(cable.colors) == 10  # five spans between six routing points
    reds = [colour.r for colour in cable.colors]
    assert reds == sorted(reds, reverse=True)
    assert reds[0] > reds[-1]
    # the span's two ends have one colour, and it begins where the one before ends
    assert [cable.colors[k].r for k in (0, 2, 4, 6, 8)] == [cable.colors[k].r for k in (1, 3, 5, 7, 9)]
    assert all(cable.points[k] == cable.points[k + 1] for k in (1, 3, 5, 7))
    assert contact.scale.x == pytest.approx(0.006)  # a millimetre a newton beyond the free motion's
    assert contact.pose.position == message.fingers[1].tip
    assert finger.points[-1] == seen.fingers[0].tip
    cell.publish(cell_state("hook"))
    message.fingers = []
    seen.fingers = []
    peer.spin_until(lambda: set(drawn()) == {""})


def test_robot_state_publisher_is_given_each_description_also_after_it_came_again(peer: Peer) -> None:
    """It reads its parameter alone, so without that a swap would leave the old fingers in tf."""
    cell = peer.node.create_publisher(CellState, "cell/state", LATCHED)
    descriptions = peer.hear(String, "robot_description", LATCHED)
    fixed = peer.hear(TFMessage, "/tf_static", LATCHED)
    peer.start("publish_tf:=false")
    peer.spin_until(lambda: descriptions)

    def given(publisher: Node) -> str:
        rclpy.spin_once(publisher, timeout_sec=0.01)
        return publisher.get_parameter("robot_description").value

    for profile in ("hook", "pinch"):  # each mounted while nobody computes tf
        seen = len(descriptions)
        cell.publish(cell_state(profile))
        peer.spin_until(lambda seen=seen: len(descriptions) > seen)
        publisher = rclpy.create_node("robot_state_publisher")
        publisher.declare_parameter("robot_description", "of its launch file")
        peer.spin_until(lambda publisher=publisher: given(publisher) == descriptions[-1].data)
        cell.publish(cell_state("power"))
        peer.spin_until(lambda seen=seen: len(descriptions) > seen + 1)
        peer.spin_until(lambda publisher=publisher: given(publisher) == descriptions[-1].data)
        publisher.destroy_node()
    assert not fixed


def test_a_state_publisher_that_replaces_a_killed_one_is_given_the_description(peer: Peer) -> None:
    """DDS believes a killed one alive for seconds; its successor says on the topic what it began with."""
    descriptions = peer.hear(String, "robot_description", LATCHED)
    peer.start("publish_tf:=false")
    publisher = rclpy.create_node("robot_state_publisher")
    publisher.declare_parameter("robot_description", "of its launch file")

    def given() -> str:
        rclpy.spin_once(publisher, timeout_sec=0.01)
        return publisher.get_parameter("robot_description").value

    peer.spin_until(lambda: bool(descriptions) and given() == descriptions[-1].data)
    text = descriptions[-1].data
    publisher.set_parameters([Parameter("robot_description", value="of its launch file")])
    says = publisher.create_publisher(String, "robot_description", LATCHED)
    says.publish(String(data="of its launch file"))
    peer.spin_until(lambda: given() == text)
    publisher.destroy_node()


def test_a_finger_that_cannot_be_mounted_is_named_and_the_last_description_stays(peer: Peer) -> None:
    descriptions = peer.hear(String, "robot_description", LATCHED)
    health = peer.hear(DiagnosticArray, "/diagnostics", RELIABLE)
    cell = peer.node.create_publisher(CellState, "cell/state", LATCHED)
    peer.start()
    peer.spin_until(lambda: descriptions)
    cell.publish(cell_state("velcro"))

    def named() -> bool:
        texts = [status.message for message in health for status in message.status]
        return any("expected one of" in text and "velcro" in text for text in texts)

    peer.spin_until(named)
    assert len(descriptions) == 1


def test_a_hand_file_that_does_not_exist_is_a_reason_to_refuse_to_start(peer: Peer) -> None:
    process = peer.start("hand_file:=/nonexistent/hand.yaml")
    assert process.wait(60.0) == 2
    assert "expected a hand file, found: " in process.stderr.read()


def test_a_description_that_was_not_taken_is_given_again() -> None:
    link = StatePublisherLink.__new__(StatePublisherLink)
    link.text, link._given = "a robot", ""
    answer = Future()
    answer.set_exception(RuntimeError("busy"))
    link._answer = (link.text, answer)
    link._on_answer(*link._answer)
    assert (link._answer, link._given) == (None, "")
