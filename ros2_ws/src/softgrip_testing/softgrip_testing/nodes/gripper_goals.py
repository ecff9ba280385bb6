# SPDX-License-Identifier: Apache-2.0
"""Ten goals of control_msgs/ParallelGripperCommand with the flags that they end with, for every server of that action.

What is expected is what ros2_controllers does (``goal_callback``, ``cancel_callback`` and ``check_for_success`` of
parallel_gripper_controller/parallel_gripper_action_controller_impl.hpp) on hardware that follows every command, or that
stands still (``disable_commands`` of mock_components/GenericSystem). parallel_gripper_controller 4.42.1 in the
controller_manager of ros2_control 4.46.0 (Jazzy) ended all ten so on that hardware. The cell's own server is held to
the same table by a test; another release of the real controller by

    python3 -m softgrip_testing.nodes.gripper_goals blocked --description > mock.urdf   # for robot_state_publisher
    python3 -m softgrip_testing.nodes.gripper_goals blocked                             # beside its controllers
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import ParallelGripperCommand
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from softgrip_nodekit import SENSOR

if TYPE_CHECKING:
    _Client = ActionClient[ParallelGripperCommand.Goal, ParallelGripperCommand.Result, ParallelGripperCommand.Feedback]

#: As in softgrip_bringup/controllers/gripper.yaml [m].
TOLERANCE_M = 0.002
#: Where the joint of the mock hardware begins [m].
_START_M = 0.1
#: A gripper that stands still is said to be no further from where it stood [m].
_STILL_M = 0.0001
_DEADLINE_S = 30.0

_ENDS = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_ABORTED: "aborted",
    GoalStatus.STATUS_CANCELED: "canceled",
}


class MockSetting(StrEnum):
    """What stands behind the server: hardware that follows, that stands still, or that with allow_stalling false."""

    FREE = "free"
    BLOCKED = "blocked"
    STRICT = "strict"


@dataclass(frozen=True)
class GoalFlags:
    """How a goal ended: "succeeded", "aborted", "canceled" or "rejected", and control_msgs' flags."""

    end: str
    reached_goal: bool = False
    stalled: bool = False


@dataclass(frozen=True)
class GoalAnswer:
    """What came back for a goal: flags, and position [m] and effort [N] of the result's state."""

    flags: GoalFlags
    position_m: tuple[float, ...] = ()
    effort_n: tuple[float, ...] = ()


REACHED = GoalFlags("succeeded", reached_goal=True)
STALLED = GoalFlags("succeeded", stalled=True)


@dataclass(frozen=True)
class GoalCase:
    """One goal.

    Attributes:
        name: in words.
        setting: that it is sent in.
        expected: outcome.
        offsets_m: of the goal's positions from where the gripper stands; negative closes.
        velocity_m_s, effort_n: of the goal, where it has them.
        is_cancelled: by the client as soon as it was accepted.
    """

    name: str
    setting: MockSetting
    expected: GoalFlags
    offsets_m: tuple[float, ...]
    velocity_m_s: tuple[float, ...] = ()
    effort_n: tuple[float, ...] = ()
    is_cancelled: bool = False

    def disagreement(self, answer: GoalAnswer, standing_m: float) -> str:
        """Return what differs from ros2_controllers, "" for nothing.

        A result says one position, which is within the tolerance of a goal that was reached, and where the gripper
        stands for a stalled one; that of a cancelled goal says none. Efforts are not compared: there the member
        ``computed_command_`` comes back, which nothing ever sets.

        Args:
            answer: what came back.
            standing_m: where the gripper stood when the goal was sent.
        """
        if answer.flags != self.expected:
            return f"expected {self.expected}, found {answer.flags}"
        if not (self.expected.reached_goal or self.expected.stalled):
            return f"expected no state, found {answer}" if answer.position_m or answer.effort_n else ""
        at_m, within_m = (
            (standing_m + self.offsets_m[0], TOLERANCE_M) if self.expected.reached_goal else (standing_m, _STILL_M)
        )
        if len(answer.position_m) == len(answer.effort_n) == 1 and abs(answer.position_m[0] - at_m) < within_m:
            return ""
        return f"expected a position within {within_m} m of {at_m:.4f} m and an effort, found {answer}"


TEN_GOALS = (
    GoalCase("closes", MockSetting.FREE, REACHED, (-0.030,)),
    GoalCase("opens again", MockSetting.FREE, REACHED, (0.030,)),
    GoalCase("closes with a velocity and an effort", MockSetting.FREE, REACHED, (-0.020,), (0.05,), (8.0,)),
    GoalCase("says two positions", MockSetting.FREE, GoalFlags("rejected"), (-0.010, -0.010)),
    GoalCase("says no position", MockSetting.FREE, GoalFlags("rejected"), ()),
    GoalCase("is there but for less than the tolerance", MockSetting.BLOCKED, REACHED, (-0.75 * TOLERANCE_M,)),
    GoalCase("is further than the tolerance and stands", MockSetting.BLOCKED, STALLED, (-1.5 * TOLERANCE_M,)),
    GoalCase("is far away and stands", MockSetting.BLOCKED, STALLED, (-0.030,)),
    GoalCase("is cancelled before it stalls", MockSetting.BLOCKED, GoalFlags("canceled"), (-0.030,), is_cancelled=True),
    GoalCase("stands where that is no success", MockSetting.STRICT, GoalFlags("aborted", stalled=True), (-0.030,)),
)


def outcome_of(
    case: GoalCase, client: _Client, standing_m: float, until: Callable[[Callable[[], object]], None]
) -> GoalAnswer:
    """Send a goal and return how it ended.

    Args:
        case: the goal.
        client: of the action.
        standing_m: where the gripper stands.
        until: spins the client's node until a condition holds, or raises.
    """
    command = JointState(
        position=[standing_m + offset for offset in case.offsets_m],
        velocity=list(case.velocity_m_s),
        effort=list(case.effort_n),
    )
    sent = client.send_goal_async(ParallelGripperCommand.Goal(command=command))
    until(sent.done)
    handle = sent.result()
    if not handle.accepted:
        return GoalAnswer(GoalFlags("rejected"))
    ended = handle.get_result_async()
    if case.is_cancelled:
        until(handle.cancel_goal_async().done)
    until(ended.done)
    answer = ended.result()
    end = _ENDS.get(answer.status, f"status {answer.status}")
    result = answer.result
    return GoalAnswer(
        GoalFlags(end, result.reached_goal, result.stalled), tuple(result.state.position), tuple(result.state.effort)
    )


def mock_description(setting: MockSetting, joint: str) -> str:
    """Return a URDF whose one joint hangs on ros2_control's mock hardware in a setting."""
    disabled = str(setting is not MockSetting.FREE).lower()
    interfaces = "\n".join(
        [f'      <command_interface name="{name}"/>' for name in ("position", "effort")]
        + [
            f'      <state_interface name="{name}"><param name="initial_value">{value}</param></state_interface>'
            for name, value in (("position", _START_M), ("velocity", 0.0), ("effort", 0.0))
        ]
    )
    return f"""<?xml version="1.0"?>
<robot name="mock_gripper">
  <link name="palm"/>
  <link name="opening"/>
  <joint name="{joint}" type="prismatic">
    <parent link="palm"/>
    <child link="opening"/>
    <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.15" effort="35" velocity="0.1"/>
  </joint>
  <ros2_control name="mock" type="system">
    <hardware>
      <plugin>mock_components/GenericSystem</plugin>
      <param name="disable_commands">{disabled}</param>
    </hardware>
    <joint name="{joint}">
{interfaces}
    </joint>
  </ros2_control>
</robot>
"""


class _GoalSender(Node):
    """A client of the action that knows where the gripper stands."""

    def __init__(self, action: str, joint: str, states: str) -> None:
        super().__init__("gripper_goals")
        self.client: _Client = ActionClient(self, ParallelGripperCommand, action)
        self._positions_m: list[float] = []
        self._joint = joint
        self.create_subscription(JointState, states, self._on_state, SENSOR)

    def _on_state(self, message: JointState) -> None:
        if self._joint in message.name:
            self._positions_m.append(message.position[list(message.name).index(self._joint)])

    def until(self, condition: Callable[[], object]) -> None:
        """Spin until a condition holds.

        Raises:
            TimeoutError: it did not within half a minute.
        """
        end = time.monotonic() + _DEADLINE_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"no answer within {_DEADLINE_S:g} s; is the controller active?")
            rclpy.spin_once(self, timeout_sec=0.05)

    def standing_m(self) -> float:
        """Return where the gripper stands now."""
        self._positions_m.clear()
        # the first one may be older than the last goal's end
        self.until(lambda: len(self._positions_m) > 1 and self.client.server_is_ready())
        return self._positions_m[-1]


def main(args: Sequence[str] | None = None) -> int:
    """Send the goals of a setting to a server, one JSON line each; exit code 1 where one ends otherwise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("setting", type=MockSetting, choices=list(MockSetting))
    parser.add_argument("--description", action="store_true", help="write the mock hardware's URDF instead")
    parser.add_argument("--joint", default="gripper_opening")
    parser.add_argument("--action", default="gripper_controller/gripper_cmd")
    parser.add_argument("--states", default="joint_states")
    options = parser.parse_args(args)
    if options.description:
        sys.stdout.write(mock_description(options.setting, options.joint))
        return 0
    rclpy.init()
    sender = _GoalSender(options.action, options.joint, options.states)
    agreed = True
    for case in TEN_GOALS:
        if case.setting is not options.setting:
            continue
        standing_m = sender.standing_m()
        answer = outcome_of(case, sender.client, standing_m, sender.until)
        disagreement = case.disagreement(answer, standing_m)
        agreed &= not disagreement
        line = {"goal": case.name, "standing_m": standing_m, **asdict(answer), "disagreement": disagreement}
        sys.stdout.write(json.dumps(line) + "\n")
    rclpy.try_shutdown()
    return 0 if agreed else 1


if __name__ == "__main__":
    sys.exit(main())
