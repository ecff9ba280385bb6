# SPDX-License-Identifier: Apache-2.0
"""A grasp policy in the live emulated cell: tendon/state in, tendon/trajectory out, the tendons leased meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_cell.products import Product
from softgrip_gym.grasp_policy import GraspPolicy
from softgrip_gym.tendons import PERIOD_S, SLOTS, next_targets, product_observation, tendon_observation
from softgrip_interfaces.msg import EmulatorTruth, LeaseHeartbeat
from softgrip_interfaces.srv import AcquireLease, MountFingers, PlaceObject, ReleaseLease
from softgrip_nodekit import RELIABLE, SENSOR, seconds
from softgrip_nodekit.errors import SuccessResponseT
from softgrip_time.units import to_ns

if TYPE_CHECKING:
    from rclpy.client import Client

    from softgrip_gym.tendons import Array

Request = TypeVar("Request")

#: [s] that a service, a homing, and the next tendon/state may take.
SERVICE_TIMEOUT_S: Final = 10.0
HOMING_TIMEOUT_S: Final = 90.0
SILENCE_TIMEOUT_S: Final = 5.0
#: An action goes on for at most so many periods where the next tendon/state comes late.
MAX_LATE_PERIODS: Final = 4
#: [s] without a heartbeat after which the driver ends the lease; one goes out with every command.
LEASE_S: Final = 2.0


class PolicyRunError(Exception):
    """Says what was expected of the cell, what was found and what to do."""


@dataclass(frozen=True)
class PolicyRun:
    """How a run ended, by the emulated cell's truth, which the policy never sees."""

    product: str
    is_held: bool
    touching: bool
    slipped: bool
    crushed: bool
    actions: int


class PolicyRunner:
    """Runs a policy on one product.

    Args:
        node: to speak through; nobody else spins it.
        policy: what to do.
    """

    def __init__(self, node: Node, policy: GraspPolicy) -> None:
        self._node, self._policy = node, policy
        self._state: JointState | None = None
        self._truth: EmulatorTruth | None = None
        node.create_subscription(JointState, "tendon/state", self._on_state, SENSOR)
        node.create_subscription(EmulatorTruth, "emulator/truth", self._on_truth, SENSOR)
        self._orders = node.create_publisher(JointTrajectory, "tendon/trajectory", RELIABLE)
        self._heartbeats = node.create_publisher(LeaseHeartbeat, "tendon/heartbeat", RELIABLE)
        self._home = node.create_client(Trigger, "tendon/home")
        self._release = node.create_client(Trigger, "tendon/release")
        self._place = node.create_client(PlaceObject, "emulator/place_object")
        self._mount = node.create_client(MountFingers, "emulator/mount")
        self._lease = node.create_client(AcquireLease, "tendon/lease")
        self._lease_release = node.create_client(ReleaseLease, "tendon/lease_release")

    def grasp(self, product: Product, close_s: float, hold_s: float) -> PolicyRun:
        """Mount the policy's fingers, home, place the product, follow the policy, open.

        Args:
            product: that the emulated cell has, too.
            close_s: that the fingers have, as in training [s]; the emulated cell lifts once the grip has settled.
            hold_s: that the policy goes on afterwards [s].

        Raises:
            PolicyRunError: the cell does not answer, refuses, or falls silent.
        """
        self._call(self._place, PlaceObject.Request(product=""))
        serials = [f"{self._policy.finger_set}-{slot}-1" for slot in SLOTS]
        sets = [self._policy.finger_set] * len(SLOTS)
        self._call(self._mount, MountFingers.Request(fingers=list(SLOTS), serials=serials, profiles=sets))
        self._call(self._home, Trigger.Request(), HOMING_TIMEOUT_S)
        self._call(self._place, PlaceObject.Request(product=product.id))
        granted = self._call(
            self._lease, AcquireLease.Request(owner="softgrip_gym policy", tendons=list(SLOTS), duration=LEASE_S)
        )
        try:
            actions = self._follow(product, close_s, hold_s, granted.token)
            truth = self._truth
            self._call(self._lease_release, ReleaseLease.Request(token=granted.token))
        finally:
            self._call(self._release, Trigger.Request(), HOMING_TIMEOUT_S)
        if truth is None:
            raise PolicyRunError("expected emulator/truth, found nothing; policies run in the emulated cell only")
        is_held = truth.product == product.id and truth.held and not (truth.slipped or truth.crushed)
        return PolicyRun(product.id, is_held, truth.touching, truth.slipped, truth.crushed, actions)

    def _follow(self, product: Product, close_s: float, hold_s: float, token: str) -> int:
        """Act every 50 ms of the cell's time; return how often."""
        known, targets_m = product_observation(product), np.zeros(len(SLOTS))
        begun_s = now_s = self._next_state(0.0)
        actions, periods = 0, 1
        while now_s - begun_s < close_s + hold_s:
            left = max(0.0, 1.0 - (now_s - begun_s) / close_s)
            observation = np.concatenate([self._tendons(targets_m), known, [left]]).astype(np.float32)
            action = self._policy.act(observation)
            for _ in range(periods):
                targets_m = next_targets(targets_m, action)
            self._command(targets_m, token)
            actions += 1
            before_s, now_s = now_s, self._next_state(now_s + PERIOD_S)
            # a state that came late: the same action goes on for as long, as far as a few periods
            periods = min(MAX_LATE_PERIODS, max(1, round((now_s - before_s) / PERIOD_S)))
        return actions

    def _tendons(self, targets_m: NDArray[np.float64]) -> Array:
        state = self._state
        assert state is not None, "a state has been waited for"
        order = [list(state.name).index(slot) for slot in SLOTS]
        lengths_m, speeds_m_s, tensions_n = (
            [float(row[i]) for i in order] for row in (state.position, state.velocity, state.effort)
        )
        return tendon_observation(lengths_m, speeds_m_s, tensions_n, targets_m.tolist())

    def _command(self, targets_m: NDArray[np.float64], token: str) -> None:
        point = JointTrajectoryPoint(
            positions=[float(target_m) for target_m in targets_m],
            time_from_start=Duration(nanosec=to_ns(PERIOD_S)),
        )
        message = JointTrajectory(joint_names=list(SLOTS), points=[point])
        message.header.frame_id = token
        self._heartbeats.publish(LeaseHeartbeat(token=token))
        self._orders.publish(message)

    def _next_state(self, from_s: float) -> float:
        """Wait for a tendon/state stamped at a time [s] or later; return its stamp [s]."""
        self._until(lambda: self._stamp_s() >= from_s, SILENCE_TIMEOUT_S, "tendon/state")
        return self._stamp_s()

    def _stamp_s(self) -> float:
        if self._state is None or not set(SLOTS) <= set(self._state.name):
            return -np.inf
        return seconds(self._state.header.stamp)

    def _call(
        self, client: Client[Request, SuccessResponseT], request: Request, timeout_s: float = SERVICE_TIMEOUT_S
    ) -> SuccessResponseT:
        self._until(client.service_is_ready, SERVICE_TIMEOUT_S, f"service {client.srv_name}")
        future = client.call_async(request)
        self._until(future.done, timeout_s, f"an answer of {client.srv_name}")
        answer = future.result()
        if not answer.success:
            raise PolicyRunError(f"{client.srv_name} refused: {answer.message}")
        return answer

    def _until(self, condition: Callable[[], bool], timeout_s: float, expected: str) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline_s:
                raise PolicyRunError(
                    f"expected {expected} within {timeout_s:g} s, found nothing; is a cell running (`make cell`)?"
                )
            rclpy.spin_once(self._node, timeout_sec=0.05)

    def _on_state(self, message: JointState) -> None:
        self._state = message

    def _on_truth(self, message: EmulatorTruth) -> None:
        self._truth = message
