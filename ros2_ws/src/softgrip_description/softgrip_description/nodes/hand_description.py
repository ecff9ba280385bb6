# SPDX-License-Identifier: Apache-2.0
"""hand_description: the mounted hand as robot_description, joint_states and tf, for RViz, MoveIt and others."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from softgrip_description.errors import HandError
from softgrip_description.geometry import Array, quaternion_of
from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_description.nodes.markers import HandMarkers
from softgrip_description.opening import gripper_opening
from softgrip_description.pose_feed import HandPose
from softgrip_description.ros2_control import GripperJoint, with_gripper_joint
from softgrip_description.urdf import fixed_transforms, urdf_of
from softgrip_interfaces.msg import CellState, FingerStates, MountedFinger
from softgrip_model.profile import ProfileError, load_profiles, mounting_of
from softgrip_nodekit import (
    LATCHED,
    RELIABLE,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    run,
    startup_errors,
    steady_timer,
    transform_message,
)

if TYPE_CHECKING:
    from rclpy.task import Future

#: Limits that URDF wants of a joint [N], [m/s]: the defaults of gripper_command's effort_limit_n and max_velocity_m_s.
_EFFORT_N, _VELOCITY_M_S = 35.0, 0.1
_GIVE_PERIOD_S = 0.2

PARAMETERS = ParameterTable(
    Parameter("hand_file", "", "hand file; empty = the shipped hand"),
    Parameter("profiles_directory", "", "folder of finger profiles; empty = those of softgrip_bringup"),
    Parameter("fingers", ["index", "middle", "thumb"], "slots that hold a finger until cell/state says otherwise"),
    Parameter("profiles", ["power", "power", "power"], "profile in each of these slots, or one for all"),
    Parameter("joint_source", "predicted", "where joint angles and tips come from", choices=("predicted", "measured")),
    Parameter("frame_prefix", "", "before every link and joint name, so that several hands fit one tf tree"),
    Parameter("gripper_joint", "", "name of a joint for the opening, with a ros2_control tag; empty = none"),
    Parameter(
        "publish_tf", True, "false where robot_state_publisher, in the same namespace, computes tf from the description"
    ),
    Parameter("marker_rate_hz", 5.0, "of hand/markers at most; 0 = none", "Hz", 0.0, 60.0),
)


class StatePublisherLink:
    """Gives robot_state_publisher each description: it takes one as a parameter, and none from a topic.

    Attributes:
        text: the present description.
    """

    def __init__(self, node: CellNode, diagnostics: Diagnostics) -> None:
        self.text = ""
        self._given = ""
        self._diagnostics = diagnostics
        self._client = node.create_client(SetParameters, "robot_state_publisher/set_parameters")
        self._answer: tuple[str, Future[SetParameters.Response]] | None = None
        node.create_subscription(String, "robot_description", self._on_description, LATCHED)
        steady_timer(node, _GIVE_PERIOD_S, self._give)

    def _on_description(self, message: String) -> None:
        """Notice a publisher that began while the one before still seemed to be there: it says its launch file's."""
        if message.data != self.text:
            self._given, self._answer = "", None

    def _give(self) -> None:
        if not self._client.service_is_ready():
            self._given, self._answer = "", None
            self._report("expected robot_state_publisher in this namespace, found none: nobody computes tf")
        elif self._answer is not None:
            if self._answer[1].done():
                self._on_answer(*self._answer)
        elif self.text != self._given:
            value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=self.text)
            request = SetParameters.Request(parameters=[ParameterMessage(name="robot_description", value=value)])
            self._answer = (self.text, self._client.call_async(request))

    def _on_answer(self, text: str, future: Future[SetParameters.Response]) -> None:
        self._answer = None
        if future.exception() is not None:
            return  # it was too busy to take it: `_give` asks again
        self._given = text
        result = future.result().results[0]
        self._report("" if result.successful else f"robot_state_publisher refuses the description: {result.reason}")

    def _report(self, problem: str) -> None:
        self._diagnostics.set("robot_state_publisher", Health.WARN if problem else Health.OK, problem or "follows")


class HandDescription(CellNode):
    """Translates between topics and a `HandPose`."""

    def __init__(self) -> None:
        super().__init__("hand_description")
        values = PARAMETERS.declare(self)
        self._prefix: str = values["frame_prefix"]
        self._gripper_joint: str = values["gripper_joint"]
        self._hand = _load_hand(values["hand_file"])
        with startup_errors(ProfileError):
            self._profiles = load_profiles(values["profiles_directory"])
        self._pose = HandPose(self._hand, self._profiles, self._prefix)
        self._diagnostics = Diagnostics(self)
        self._state_publisher = None if values["publish_tf"] else StatePublisherLink(self, self._diagnostics)
        self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._joints = self.create_publisher(JointState, "joint_states", RELIABLE)
        # tf2 listens to these two absolute names; the prefix keeps several hands apart.
        self._tf = self.create_publisher(TFMessage, "/tf", RELIABLE)
        self._tf_static = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        with startup_errors(HandError, ProfileError):
            self._pose.set_mounted(mounting_of(values["fingers"], values["profiles"]))
        self._publish_description()
        self._source: str = values["joint_source"]
        self._markers = HandMarkers(self._pose, self._prefix)
        self._marker_arrays = self.create_publisher(MarkerArray, "hand/markers", SENSOR)
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.create_subscription(FingerStates, "finger/predicted", self._on_predicted, SENSOR)
        self.create_subscription(FingerStates, "finger/measured", self._on_measured, SENSOR)
        self.create_subscription(JointState, "tendon/state", self._on_tendons, SENSOR)
        if values["marker_rate_hz"] > 0.0:
            steady_timer(self, 1.0 / values["marker_rate_hz"], self._publish_markers)
        self.get_logger().info(f"describing {self._mounted()}; joints from finger/{self._source}")

    def _on_cell(self, message: CellState) -> None:
        mounted = {
            finger.finger: finger.profile
            for finger in message.mounted
            if finger.profile and finger.state != MountedFinger.EMPTY
        }
        try:
            changed = self._pose.set_mounted(mounted)
        except (HandError, ProfileError) as error:
            self._diagnostics.set("hand", Health.WARN, f"{error}; still describing {self._mounted()}")
            return
        if changed:
            self._markers.clear()
            self._publish_description()

    def _on_predicted(self, message: FingerStates) -> None:
        self._markers.set_predicted(message.fingers)
        if self._source == "predicted":
            self._on_fingers(message)

    def _on_measured(self, message: FingerStates) -> None:
        self._markers.set_measured(message.fingers)
        if self._source == "measured":
            self._on_fingers(message)

    def _on_tendons(self, message: JointState) -> None:
        self._markers.set_tensions(dict(zip(message.name, message.effort, strict=False)))

    def _publish_markers(self) -> None:
        self._marker_arrays.publish(self._markers.message(self.get_clock().now().to_msg()))

    def _on_fingers(self, message: FingerStates) -> None:
        taken = [
            self._pose.set_finger(finger.finger, finger.joint_angles, (finger.tip.x, finger.tip.y))
            for finger in message.fingers
        ]
        if not any(taken):
            return
        names, positions = self._pose.joint_state()
        self._joints.publish(JointState(header=Header(stamp=message.header.stamp), name=names, position=positions))
        if self._state_publisher is None:
            transforms = self._pose.link_transforms()
            self._tf.publish(TFMessage(transforms=[_transform(message.header.stamp, *one) for one in transforms]))

    def _publish_description(self) -> None:
        text = self._urdf()
        self._description.publish(String(data=text))
        if self._state_publisher is not None:
            self._state_publisher.text = text
        else:
            stamp = self.get_clock().now().to_msg()
            transforms = [*fixed_transforms(self._hand, self._pose.fingers, self._prefix)]
            transforms += self._pose.mount_transforms()
            self._tf_static.publish(TFMessage(transforms=[_transform(stamp, *one) for one in transforms]))
        self._diagnostics.set("hand", Health.OK, "as mounted by cell/state", self._mounted())

    def _urdf(self) -> str:
        text = urdf_of(self._hand, self._pose.fingers, prefix=self._prefix)
        if not self._gripper_joint:
            return text
        try:
            opening = gripper_opening(self._hand, self._profiles, self._mounted())
        except HandError as error:
            self._diagnostics.set("gripper joint", Health.WARN, f"left out: {error}")
            return text
        self._diagnostics.set("gripper joint", Health.OK, f"{opening.min_m:.4f} to {opening.max_m:.4f} m")
        joint = GripperJoint(
            name=self._gripper_joint,
            min_m=opening.min_m,
            max_m=opening.max_m,
            effort_n=_EFFORT_N,
            velocity_m_s=_VELOCITY_M_S,
            states_topic=self.resolve_topic_name("gripper/joint_states"),
            commands_topic=self.resolve_topic_name("gripper/joint_commands"),
        )
        return with_gripper_joint(text, joint, self._prefix)

    def _mounted(self) -> dict[str, str]:
        return {slot: profile for slot, (profile, _) in self._pose.fingers.items()}


@startup_errors(HandError)
def _load_hand(path: str) -> Hand:
    return load_hand(Path(path)) if path else shipped_hand()


def _transform(stamp: Time, parent: str, child: str, pose: Array) -> TransformStamped:
    return transform_message(stamp, parent, child, pose[:3, 3], quaternion_of(pose))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(HandDescription, args)


if __name__ == "__main__":
    sys.exit(main())
