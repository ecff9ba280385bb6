# SPDX-License-Identifier: Apache-2.0
"""The way of teleoperation to the fingers: tendon/state in, tendon/trajectory out, the tendons leased meanwhile."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration, Time
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_design.errors import DesignError
from softgrip_design.landmarks import CHAINS
from softgrip_design.teleoperation.session import DeadManSwitch, TeleoperationFrame
from softgrip_interfaces.msg import (
    CellState,
    FrictionModel,
    LeaseHeartbeat,
    MountedFinger,
    SafetyState,
    TeleoperationState,
    TendonOwners,
    TendonStatusArray,
)
from softgrip_interfaces.srv import AcquireLease, ReleaseLease, StartRecording, StopRecording
from softgrip_model.friction.acceptance import accept
from softgrip_model.friction.errors import LawError
from softgrip_model.friction.laws import FrictionLaw
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, seconds, to_time_message
from softgrip_nodekit.errors import SuccessResponseT
from softgrip_time.units import to_ns

if TYPE_CHECKING:
    from rclpy.client import Client

Request = TypeVar("Request")
Response = TypeVar("Response")

Array = NDArray[np.float64]

OWNER: Final = "teleoperation"
#: [s] that a service, a homing, a hand-over and the first messages may take.
SERVICE_TIMEOUT_S: Final = 10.0
HOMING_TIMEOUT_S: Final = 90.0
HAND_OVER_TIMEOUT_S: Final = 10.0
START_TIMEOUT_S: Final = 10.0
#: [s] in which tendon/status says that a tendon is homed.
HOMED_TIMEOUT_S: Final = 2.0
#: [s] without a heartbeat after which the driver ends the lease; they go out while frames come within the last time.
LEASE_S: Final = 1.0
HEARTBEAT_S: Final = 0.25
MAX_FRAME_PERIOD_S: Final = 3.0
#: tendon/state older than this is silence [s].
STATE_TIMEOUT_S: Final = 0.5
#: Between two tendon/state the cell's time goes on with the clock, for so long at most [s].
MAX_STATE_PERIOD_S: Final = 0.02
_POLL_S: Final = 0.01
#: Modes in which the manager wants nothing from the fingers.
_FREE_MODES: Final = (CellState.UNKNOWN, CellState.IDLE, CellState.HOLDING)


class FingerLink:
    """Speaks for one teleoperation; another thread spins the node.

    Args:
        node: to speak through.
        switch: that `teleoperate/dead_man` presses.
        max_tension_n: goes into teleoperation/state.
        task: what is shown, in words.
    """

    def __init__(self, node: Node, switch: DeadManSwitch, max_tension_n: float, task: str) -> None:
        self._switch, self._max_tension_n, self._task = switch, max_tension_n, task
        self._state: JointState | None = None
        self._arrived_s = -math.inf
        self._status: TendonStatusArray | None = None
        self._cell: CellState | None = None
        self._friction: FrictionModel | None = None
        self._safety: SafetyState | None = None
        self._owners: dict[str, str] = {}
        self._token = ""
        self._is_owner_seen = False  # tendon/owners has shown us since the lease was granted
        self._last_frame_s = -math.inf
        self.tendons: tuple[str, ...] = ()
        self.recorded_path = ""
        node.create_subscription(JointState, "tendon/state", self._on_state, SENSOR)
        node.create_subscription(TendonStatusArray, "tendon/status", self._on_status, SENSOR)
        node.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        node.create_subscription(FrictionModel, "friction/active", self._on_friction, LATCHED)
        node.create_subscription(SafetyState, "safety/state", self._on_safety, LATCHED)
        node.create_subscription(TendonOwners, "tendon/owners", self._on_owners, LATCHED)
        node.create_subscription(Bool, "teleoperation/dead_man", self._on_dead_man, RELIABLE)
        self._orders = node.create_publisher(JointTrajectory, "tendon/trajectory", RELIABLE)
        self._heartbeats = node.create_publisher(LeaseHeartbeat, "tendon/heartbeat", RELIABLE)
        self._frames = node.create_publisher(TeleoperationState, "teleoperation/state", RELIABLE)
        node.create_timer(HEARTBEAT_S, self._send_heartbeat)
        self._home = node.create_client(Trigger, "tendon/home")
        self._lease = node.create_client(AcquireLease, "tendon/lease")
        self._lease_release = node.create_client(ReleaseLease, "tendon/lease_release")
        self._record = node.create_client(StartRecording, "recorder/start")
        self._record_stop = node.create_client(StopRecording, "recorder/stop")

    # --- before and after ------------------------------------------------------------------------------------------

    def await_cell(self, tendons: Sequence[str]) -> None:
        """Wait for the cell, and choose the tendons.

        Args:
            tendons: to move; none = all that are called after fingers.

        Raises:
            DesignError: no cell, or tendons that it does not have.
        """
        hint = "is a cell running (`make cell`)?"
        self._until(lambda: self._state is not None, START_TIMEOUT_S, f"tendon/state; {hint}")
        self._until(lambda: self._status is not None, START_TIMEOUT_S, f"tendon/status; {hint}")
        self._until(lambda: self._safety is not None, START_TIMEOUT_S, f"safety/state; {hint}")
        assert self._state is not None
        known = tuple(self._state.name)
        missing = sorted(set(tendons) - set(known))
        if missing:
            raise DesignError(f"expected tendons out of {', '.join(known)}, found {', '.join(missing)}")
        self.tendons = tuple(tendons) or tuple(name for name in known if name in CHAINS)
        if not self.tendons:
            raise DesignError(
                f"expected a tendon called after a finger ({', '.join(CHAINS)}), found {', '.join(known)}"
            )

    def mounted_profiles(self) -> dict[str, str]:
        """Return slot -> profile id, as the cell has it; empty where there is no cell/state."""
        if self._cell is None:
            return {}
        mounted = [one for one in self._cell.mounted if one.profile and one.state != MountedFinger.EMPTY]
        return {one.finger: one.profile for one in mounted}

    def active_friction(self) -> FrictionLaw | None:
        """Return the friction law that is active in the cell, None where there is none.

        Raises:
            DesignError: a model that must not be used.
        """
        message = self._friction
        if message is None or message.verdict not in (FrictionModel.USABLE, FrictionModel.REPEAT_POINTS):
            return None
        try:
            return accept(message).law
        except LawError as error:
            raise DesignError(str(error)) from error

    def home(self) -> None:
        """Home the tendons.

        Raises:
            DesignError: refused, or no answer.
        """
        self._call(self._home, Trigger.Request(), HOMING_TIMEOUT_S)

    def check_homed(self) -> None:
        """Check that the zeros are known.

        Raises:
            DesignError: they are not.
        """
        deadline_s = time.monotonic() + HOMED_TIMEOUT_S
        while missing := self._not_homed():
            if time.monotonic() > deadline_s:
                raise DesignError(f"expected homed tendons, found {', '.join(missing)} not homed; start with --home")
            time.sleep(_POLL_S)

    def _not_homed(self) -> list[str]:
        status = self._status
        homed = {one.tendon for one in status.tendons if one.homed} if status is not None else set()
        return [name for name in self.tendons if name not in homed]

    @contextmanager
    def leased(self) -> Iterator[None]:
        """Own the tendons meanwhile; whoever only holds something is asked to hand over.

        Raises:
            DesignError: somebody else keeps them.
        """
        request = AcquireLease.Request(owner=OWNER, tendons=list(self.tendons), duration=LEASE_S, hand_over=True)
        deadline_s = time.monotonic() + HAND_OVER_TIMEOUT_S
        while not (answer := self._answer(self._lease, request)).success:
            if time.monotonic() > deadline_s:
                raise DesignError(f"tendon/lease refused: {answer.message}")
            time.sleep(0.5)
        self._token, self._is_owner_seen, self._last_frame_s = answer.token, False, time.monotonic()
        try:
            yield
        finally:
            token, self._token = self._token, ""
            if token:
                self._answer(self._lease_release, ReleaseLease.Request(token=token))

    @contextmanager
    def recorded(self, path: str) -> Iterator[None]:
        """Order the recorder to write a bag meanwhile.

        Args:
            path: folder of the bag below the recorder's root; empty = a name made from date and time.

        Raises:
            DesignError: the recorder refuses, or does not answer.
        """
        self._call(self._record, StartRecording.Request(path=path))
        try:
            yield
        finally:
            self.recorded_path = self._call(self._record_stop, StopRecording.Request(), 30.0).path

    # --- while it runs ---------------------------------------------------------------------------------------------

    def cell_time_s(self) -> float:
        """Return the cell's time [s]: of the last tendon/state, and on from there until the next one is due."""
        state = self._state
        if state is None:
            return 0.0
        since_s = time.monotonic() - self._arrived_s
        return seconds(state.header.stamp) + min(max(0.0, since_s), MAX_STATE_PERIOD_S)

    def lengths_m(self) -> Array:
        """Return the measured pulled lengths, (tendons,) [m]."""
        state = self._state
        assert state is not None, "await_cell has waited for it"
        order = [list(state.name).index(name) for name in self.tendons]
        measured: Array = np.array([state.position[index] for index in order], float)
        return np.maximum(measured, 0.0)

    def find_problem(self) -> str:
        """Return why nothing may move; empty when nothing is in the way. Without calls the lease ends.

        Raises:
            DesignError: somebody else has the tendons now.
        """
        if not self._token:
            return "the tendons are not leased"
        self._last_frame_s = time.monotonic()
        if time.monotonic() - self._arrived_s > STATE_TIMEOUT_S:
            return "tendon/state is silent"
        return self._stop_reason() or self._fault() or self._other_user()

    def _stop_reason(self) -> str:
        safety = self._safety
        if safety is None:
            return "safety/state is unknown"
        if safety.estop:
            return f"emergency stop: {safety.estop_reason}"
        return f"locked by {safety.lock_owner}: {safety.lock_reason}" if safety.locked else ""

    def _fault(self) -> str:
        status = self._status
        found = [] if status is None else [f"{one.tendon}: {one.fault}" for one in status.tendons if one.fault]
        return "; ".join(found)

    def _other_user(self) -> str:
        if self._cell is not None and self._cell.mode not in _FREE_MODES:
            return "the cell is at work (cell/state)"
        others = {self._owners.get(name, OWNER) or "nobody" for name in self.tendons} - {OWNER}
        self._is_owner_seen = self._is_owner_seen or not others
        if not others:
            return ""
        found = f"the tendons belong to {', '.join(sorted(others))}"
        if self._is_owner_seen:
            raise DesignError(f"expected to own the tendons (tendon/owners), found that {found}; start again")
        return found

    def order(self, stamp_s: float, lengths_m: Array, duration_s: float) -> None:
        """Move the tendons there within a time [s]."""
        point = JointTrajectoryPoint(
            positions=[float(length) for length in lengths_m], time_from_start=Duration(nanosec=to_ns(duration_s))
        )
        header = Header(stamp=_stamp(stamp_s), frame_id=self._token)
        self._orders.publish(JointTrajectory(header=header, joint_names=list(self.tendons), points=[point]))

    def show(self, frame: TeleoperationFrame) -> None:
        """Publish what became of a frame."""
        self._frames.publish(
            TeleoperationState(
                header=Header(stamp=_stamp(frame.stamp_s)),
                episode=frame.episode,
                phase=int(frame.phase),
                task=self._task,
                is_held=frame.is_held,
                has_hand=frame.has_hand,
                tendons=list(self.tendons),
                deflections=frame.deflections_rad.tolist(),
                joint_angles=frame.joint_angles_rad.tolist(),
                targets=frame.targets_m.tolist(),
                duration=frame.duration_s,
                tension_limit=self._max_tension_n,
                reason=frame.reason,
            )
        )

    # --- in --------------------------------------------------------------------------------------------------------

    def _send_heartbeat(self) -> None:
        if self._token and time.monotonic() - self._last_frame_s < MAX_FRAME_PERIOD_S:
            self._heartbeats.publish(LeaseHeartbeat(token=self._token))

    def _on_state(self, message: JointState) -> None:
        self._state, self._arrived_s = message, time.monotonic()

    def _on_status(self, message: TendonStatusArray) -> None:
        self._status = message

    def _on_cell(self, message: CellState) -> None:
        self._cell = message

    def _on_friction(self, message: FrictionModel) -> None:
        self._friction = message

    def _on_safety(self, message: SafetyState) -> None:
        self._safety = message

    def _on_owners(self, message: TendonOwners) -> None:
        self._owners = {one.tendon: str(one.owner) for one in message.owners}

    def _on_dead_man(self, message: Bool) -> None:
        if message.data:
            self._switch.press(time.monotonic())
        else:
            self._switch.release()

    def _call(
        self, client: Client[Request, SuccessResponseT], request: Request, timeout_s: float = SERVICE_TIMEOUT_S
    ) -> SuccessResponseT:
        answer = self._answer(client, request, timeout_s)
        if not answer.success:
            raise DesignError(f"{client.srv_name} refused: {answer.message}")
        return answer

    def _answer(
        self, client: Client[Request, Response], request: Request, timeout_s: float = SERVICE_TIMEOUT_S
    ) -> Response:
        self._until(client.service_is_ready, SERVICE_TIMEOUT_S, f"service {client.srv_name}")
        done = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(timeout_s):
            raise DesignError(f"expected an answer of {client.srv_name} within {timeout_s:g} s, found none")
        return future.result()

    def _until(self, condition: Callable[[], bool], timeout_s: float, expected: str) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline_s:
                raise DesignError(f"expected {expected} within {timeout_s:g} s, found nothing")
            time.sleep(_POLL_S)


def _stamp(time_s: float) -> Time:
    stamp: Time = to_time_message(to_ns(time_s))
    return stamp
