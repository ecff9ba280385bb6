# SPDX-License-Identifier: Apache-2.0
"""gripper_command: the cell as a standard gripper, for MoveIt, NEXUS, behaviour trees and ros2_control.

Serves gripper/command (control_msgs/GripperCommand) and gripper/gripper_cmd (control_msgs/ParallelGripperCommand);
publishes gripper/joint_states and obeys gripper/joint_commands, which joint_state_topic_hardware_interface speaks.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from control_msgs.action import GripperCommand, ParallelGripperCommand
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softgrip_cell.cell import CellMode
from softgrip_cell.errors import RefusedError
from softgrip_cell.gripper.command_stream import CommandStream
from softgrip_cell.gripper.goal_monitor import GoalEnd, GoalSettings
from softgrip_cell.gripper.orders import GripperGoal, GripperLimits, TendonOrder, parallel_goal, tendon_order
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.driver_link import DriverLink, MotionLimits, MoveEnd
from softgrip_cell.nodes.gripper_server import GoalOutcome, GripperSample, GripperServer
from softgrip_cell.nodes.tendon_lease import TendonLease
from softgrip_cell.observation import StreamSilence
from softgrip_description import Hand, HandError, load_hand, shipped_hand
from softgrip_description.opening import GripperOpening, gripper_opening
from softgrip_interfaces.msg import CellState, LeaseHeartbeat, MountedFinger, SafetyState, TendonOwners
from softgrip_model.profile import Profile, ProfileError, load_profiles
from softgrip_nodekit import (
    LATCHED,
    RELIABLE,
    SENSOR,
    CellNode,
    Diagnostics,
    GoalHandle,
    Health,
    NodeIo,
    OrderGuard,
    Parameter,
    ParameterTable,
    StartupError,
    run,
    startup_errors,
    steady_timer,
)
from softgrip_time.units import to_s

_CommandHandle = GoalHandle[GripperCommand.Goal, GripperCommand.Feedback]
_ParallelHandle = GoalHandle[ParallelGripperCommand.Goal, ParallelGripperCommand.Feedback]
#: Publishes on a goal how far it is.
_FeedbackSender = Callable[[GripperSample], None]
_Result = TypeVar("_Result", GripperCommand.Result, ParallelGripperCommand.Result)

#: Who the driver names as the owner of the tendons.
WHO = "gripper_command"
#: How often heartbeats go out and silence is looked for [s].
LOOK_S = 0.1
#: Feedback of a goal goes out so often [s]; ros2_controllers' action_monitor_rate is 20 Hz.
FEEDBACK_S = 0.05
#: All tendons pulled by less: the hand holds nothing and the tendons need no owner [m].
OPEN_M = 0.002

_GOAL = GoalSettings()

PARAMETERS = ParameterTable(
    Parameter("hand_file", "", "hand file; empty = the shipped hand"),
    Parameter("profiles_directory", "", "folder of finger profiles; empty = those of softgrip_bringup"),
    Parameter("slots", ["index", "middle", "thumb"], "slots = tendons of the gripper, in order"),
    Parameter("profiles", ["power", "power", "power"], "profile in each slot until cell/state says otherwise"),
    Parameter("joint_name", "gripper_opening", "name of the gripper's one joint"),
    Parameter(
        "close_by",
        "move",
        "grasp: a closing goal grasps the selected product (cell/grasp) where one is selected",
        choices=("move", "grasp"),
    ),
    Parameter("goal_tolerance_m", _GOAL.goal_tolerance_m, "a smaller position error is none", "m", 0.0001, 0.05),
    Parameter(
        "stall_velocity_threshold_m_s",
        _GOAL.stall_velocity_threshold_m_s,
        "an opening that changes no faster stands still",
        "m/s",
        0.0,
        0.1,
    ),
    Parameter(
        "stall_timeout_s", _GOAL.stall_timeout_s, "a goal that stands still for longer is stalled", "s", 0.0, 60.0
    ),
    Parameter("allow_stalling", _GOAL.allow_stalling, "a stalled goal succeeds: gripping something is what it is for"),
    Parameter("max_effort_n", 20.0, "tension of each tendon of a goal without effort", "N", 1.0, 500.0),
    Parameter("effort_limit_n", 35.0, "largest tension that a goal may ask for", "N", 1.0, 500.0),
    Parameter("max_velocity_m_s", 0.1, "fastest change of the opening", "m/s", 0.001, 1.0),
    Parameter(
        "lease_s", 2.0, "without a heartbeat for so long the driver stops what the gripper moves", "s", 0.5, 10.0
    ),
    Parameter("order_s", 1.0, "an order that the driver would begin later than this is refused", "s", 0.1, 10.0),
    Parameter("silence_s", 1.0, "silence of tendon/state that ends a goal and refuses the next", "s", 0.3, 10.0),
)


class GripperCommandNode(CellNode):
    """Translates between control_msgs and the tendons."""

    def __init__(self) -> None:
        super().__init__(WHO)
        values = PARAMETERS.declare(self)
        self._values = values
        self._slots: list[str] = values["slots"]
        if len(values["profiles"]) != len(self._slots):
            raise StartupError(f"parameter 'profiles': expected one for each of {self._slots}, found another number")
        self._settings = GoalSettings(
            values["goal_tolerance_m"],
            values["stall_velocity_threshold_m_s"],
            values["stall_timeout_s"],
            values["allow_stalling"],
        )
        self._limits = GripperLimits(values["max_effort_n"], values["effort_limit_n"], values["max_velocity_m_s"])
        self._diagnostics = Diagnostics(self)
        self._hand, self._profiles = _load(values["hand_file"], values["profiles_directory"])
        self._mounted: dict[str, str] = {}
        self._opening: GripperOpening | None = None
        self._no_opening = ""
        self._mount(dict(zip(self._slots, values["profiles"], strict=True)))
        self._cell: CellState | None = None
        self._safety: SafetyState | None = None
        self._silence = StreamSilence(round(values["silence_s"] / LOOK_S))
        self._pulled_length_m: dict[str, float] = {}
        self._stream = CommandStream(values["goal_tolerance_m"])
        io = NodeIo(self)
        self._io = io
        heartbeats = self.create_publisher(LeaseHeartbeat, "tendon/heartbeat", RELIABLE)
        self._lease = TendonLease(
            io, heartbeats.publish, WHO, self._slots, values["lease_s"], self._on_lease_lost, ask_for_hand_over=True
        )
        motion = MotionLimits(values["max_velocity_m_s"], values["effort_limit_n"], values["order_s"])
        driver = DriverLink(io, self._slots, self._lease, motion)
        self._server = GripperServer(io, driver, self._settings, self._order_of, self._product_of)
        self._joints = self.create_publisher(JointState, "gripper/joint_states", SENSOR)
        self.create_subscription(JointState, "tendon/state", self._on_tendon_state, SENSOR)
        self.create_subscription(JointState, "gripper/joint_commands", self._on_joint_command, RELIABLE)
        self.create_subscription(SafetyState, "safety/state", self._on_safety, LATCHED)
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.create_subscription(TendonOwners, "tendon/owners", self._lease.observe_owners, LATCHED)
        self._feedback_at_s = 0.0
        self._order_guard = OrderGuard(self)
        self._senders: list[_FeedbackSender] = []
        ActionServer(
            self,
            GripperCommand,
            "gripper/command",
            execute_callback=self._run_command,
            goal_callback=lambda request: self._check(lambda: _goal_of(request)),
            cancel_callback=self._cancel,
        )
        ActionServer(
            self,
            ParallelGripperCommand,
            "gripper/gripper_cmd",
            execute_callback=self._run_parallel,
            goal_callback=lambda request: self._check(lambda: _parallel_goal_of(request)),
            cancel_callback=self._cancel,
        )
        steady_timer(self, LOOK_S, self._watch)

    def close(self) -> None:
        """Stop what this node moves and let go of the tendons."""
        self._server.hold("gripper_command is shutting down")
        self._lease.release()

    def _mount(self, mounted: dict[str, str]) -> None:
        """Take what is mounted; without an opening goals are refused with the reason."""
        if mounted == self._mounted:
            return
        self._mounted, self._opening = mounted, None
        try:
            unknown = sorted(set(mounted.values()) - set(self._profiles))
            if unknown:
                raise HandError(f"profile: expected one of {sorted(self._profiles)}, found {unknown}")
            self._opening = gripper_opening(self._hand, self._profiles, mounted)
        except (HandError, ProfileError) as error:
            self._no_opening = str(error)
            self._diagnostics.set("gripper", Health.WARN, self._no_opening, mounted)
            return
        text = f"opens from {self._opening.min_m:.4f} to {self._opening.max_m:.4f} m"
        self._diagnostics.set("gripper", Health.OK, text, mounted)

    def _on_cell(self, message: CellState) -> None:
        self._cell = message
        mounted = {
            finger.finger: finger.profile
            for finger in message.mounted
            if finger.profile and finger.state != MountedFinger.EMPTY
        }
        if mounted:
            self._mount(mounted)

    def _on_safety(self, message: SafetyState) -> None:
        self._safety = message
        stopped = self._is_stopped()
        if stopped:
            self._server.hold(stopped)
            self._lease.release()

    def _is_stopped(self) -> str:
        """Return why nothing may move, empty where it may."""
        if self._safety is None:
            return "safety/state has not been seen; start or check tendon_driver"
        if self._safety.estop:
            return f"the emergency stop is latched: {self._safety.estop_reason}"
        if self._safety.locked:
            return f"the drives are locked by '{self._safety.lock_owner}': {self._safety.lock_reason}"
        return ""

    def _on_lease_lost(self, reason: str) -> None:
        self.get_logger().warning(reason)
        self._server.end(reason)

    def _on_tendon_state(self, message: JointState) -> None:
        sample = convert.tendon_sample(message, self._slots)
        if sample is None or self._opening is None or not set(self._opening.clearances) <= set(self._slots):
            return
        self._silence.hear()
        self._pulled_length_m = dict(zip(self._slots, sample.pulled_length_m, strict=True))
        at = {name: k for k, name in enumerate(message.name)}
        speeds_m_s = {
            slot: message.velocity[at[slot]] if len(message.velocity) > at[slot] else 0.0 for slot in self._slots
        }
        gripper = GripperSample(
            time_s=to_s(sample.stamp_ns),
            position_m=self._opening.opening_m(self._pulled_length_m),
            velocity_m_s=self._opening.velocity_m_s(self._pulled_length_m, speeds_m_s),
            effort_n=max(sample.tension_n),
        )
        self._joints.publish(
            JointState(
                header=Header(stamp=message.header.stamp),
                name=[self._values["joint_name"]],
                position=[gripper.position_m],
                velocity=[gripper.velocity_m_s],
                effort=[gripper.effort_n],
            )
        )
        self._server.observe(gripper)
        self._publish_feedback(gripper)

    def _check(self, read: Callable[[], GripperGoal]) -> GoalResponse:
        """Accept a goal that can be done; the log says what was wrong with another one."""
        try:
            goal = read()
            why_not = self._is_stopped() or self._order_guard.refusal
            if why_not:
                raise RefusedError(why_not)
            if self._silence.reached or self._server.sample is None:
                raise RefusedError("expected tendon/state, found none; start or check tendon_driver")
            self._order_of(goal)
        except RefusedError as error:
            self._diagnostics.set("goal", Health.WARN, f"refused: {error}")
            self.get_logger().warning(f"goal refused: {error}")
            return GoalResponse.REJECT
        self._diagnostics.set("goal", Health.OK, "the last goal was accepted")
        return GoalResponse.ACCEPT

    def _order_of(self, goal: GripperGoal) -> TendonOrder:
        if self._opening is None:
            raise RefusedError(self._no_opening)
        return tendon_order(goal, self._opening, self._limits, self._settings.goal_tolerance_m)

    def _product_of(self, goal: GripperGoal) -> str:
        """Return the product that a closing goal grasps, "" where the fingers are just moved."""
        if self._values["close_by"] != "grasp" or self._cell is None or self._server.sample is None:
            return ""
        closes = goal.position_m < self._server.sample.position_m - self._settings.goal_tolerance_m
        return str(self._cell.product) if closes and self._cell.mode == int(CellMode.IDLE) else ""

    async def _run_command(self, handle: _CommandHandle) -> GripperCommand.Result:
        def send(sample: GripperSample) -> None:
            handle.publish_feedback(GripperCommand.Feedback(position=sample.position_m, effort=sample.effort_n))

        outcome = await self._run(_goal_of(handle.request), send)
        result = GripperCommand.Result()
        if outcome.sample is not None and not handle.is_cancel_requested:
            result.position, result.effort = outcome.sample.position_m, outcome.sample.effort_n
        return self._ended(handle, outcome, result)

    async def _run_parallel(self, handle: _ParallelHandle) -> ParallelGripperCommand.Result:
        def send(sample: GripperSample) -> None:
            handle.publish_feedback(ParallelGripperCommand.Feedback(state=self._state_of(sample)))

        outcome = await self._run(_parallel_goal_of(handle.request), send)
        result = ParallelGripperCommand.Result()
        if outcome.sample is not None and not handle.is_cancel_requested:
            result.state = self._state_of(outcome.sample)
        return self._ended(handle, outcome, result)

    async def _run(self, goal: GripperGoal, send: _FeedbackSender) -> GoalOutcome:
        self._senders.append(send)
        try:
            return await self._server.run(goal)
        finally:
            self._senders.remove(send)

    def _ended(self, handle: _CommandHandle | _ParallelHandle, outcome: GoalOutcome, result: _Result) -> _Result:
        """Set flags and state as ros2_controllers do; see softgrip_cell.gripper.goal_monitor."""
        if handle.is_cancel_requested:
            handle.canceled()
            return result  # without flags and numbers, as theirs
        result.reached_goal = outcome.end is GoalEnd.REACHED
        result.stalled = outcome.end is GoalEnd.STALLED
        if outcome.end is not None and self._settings.is_success(outcome.end):
            handle.succeed()
        else:
            self.get_logger().warning(f"goal aborted: {outcome.reason or 'stalled'}")
            handle.abort()
        return result

    def _state_of(self, sample: GripperSample) -> JointState:
        return JointState(name=[self._values["joint_name"]], position=[sample.position_m], effort=[sample.effort_n])

    def _publish_feedback(self, sample: GripperSample) -> None:
        if not self._senders or sample.time_s - self._feedback_at_s < FEEDBACK_S:
            return
        self._feedback_at_s = sample.time_s
        for send in self._senders:
            send(sample)

    def _cancel(self, _handle: object) -> CancelResponse:
        self._io.create_task(self._server.hold, "cancelled by the client; the fingers stay where they are")
        return CancelResponse.ACCEPT

    def _on_joint_command(self, message: JointState) -> None:
        """Take what a ros2_control controller commands; an action goal goes first."""
        name = self._values["joint_name"]
        at = message.name.index(name) if name in message.name else -1
        if at < 0 or len(message.position) <= at or not math.isfinite(message.position[at]):
            return  # a hardware interface whose command nobody has set yet sends NaN
        effort_n = message.effort[at] if len(message.effort) > at and math.isfinite(message.effort[at]) else 0.0
        goal = GripperGoal(message.position[at], effort_n)
        try:
            if self._is_order(goal):
                why_not = self._is_stopped() or self._order_guard.refusal
                if why_not:
                    raise RefusedError(why_not)
                self._lease.acquire(lambda why_not: self._follow(goal, why_not))
        except RefusedError as error:
            self._diagnostics.set("joint command", Health.WARN, f"refused: {error}")

    def _is_order(self, goal: GripperGoal) -> bool:
        sample = self._server.sample
        return sample is not None and self._stream.is_order(
            goal,
            sample.position_m,
            owned=bool(self._lease.token),
            busy=self._server.is_active,
            now_s=self._io.monotonic_s(),
        )

    def _follow(self, goal: GripperGoal, why_not: str) -> None:
        try:
            if why_not:
                raise RefusedError(why_not)
            order = self._order_of(goal)
        except RefusedError as error:
            self._diagnostics.set("joint command", Health.WARN, f"refused: {error}")
            return
        self._diagnostics.set("joint command", Health.OK, "the last one was carried out")
        self._server.move(order, self._stream_ended)

    def _stream_ended(self, end: MoveEnd) -> None:
        if not end.is_good:
            self._diagnostics.set("joint command", Health.WARN, f"the driver did not move: {end.reason}")

    def _watch(self) -> None:
        """Heartbeats, silence, and the tendons that nobody needs any more."""
        self._lease.send_heartbeat()
        self._silence.pass_period()
        if self._silence.reached:
            self._server.hold("expected tendon/state, found none; the fingers hold where they are")
        if self._server.is_active or not self._lease.token:
            return
        is_open = all(abs(pulled_length_m) < OPEN_M for pulled_length_m in self._pulled_length_m.values())
        if self._lease.is_requested:
            self._lease.hand_over()
        elif is_open and self._io.monotonic_s() - self._stream.changed_s > self._values["lease_s"]:
            self._lease.release()


def _goal_of(request: GripperCommand.Goal) -> GripperGoal:
    return GripperGoal(request.command.position, request.command.max_effort)


def _parallel_goal_of(request: ParallelGripperCommand.Goal) -> GripperGoal:
    return parallel_goal(request.command.position, request.command.velocity, request.command.effort)


@startup_errors(HandError, ProfileError)
def _load(hand_file: str, profiles_directory: str) -> tuple[Hand, dict[str, Profile]]:
    hand = load_hand(Path(hand_file)) if hand_file else shipped_hand()
    return hand, load_profiles(profiles_directory)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(GripperCommandNode, args)


if __name__ == "__main__":
    sys.exit(main())
