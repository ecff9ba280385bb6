# SPDX-License-Identifier: Apache-2.0
"""Teleoperation through topics and services, against a cell that pulls each tendon as it is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from std_msgs.msg import Bool

from softgrip_design.capture.detector import DetectedHand
from softgrip_design.capture.recording import LONG_FINGERS
from softgrip_design.errors import DesignError
from softgrip_design.nodes import finger_link
from softgrip_design.nodes.teleoperate import lead, parser
from softgrip_interfaces.msg import (
    CellState,
    LeaseHeartbeat,
    MountedFinger,
    SafetyState,
    TeleoperationState,
    TendonOwner,
    TendonOwners,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_interfaces.srv import StartRecording, StopRecording
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.following_cell import SLOTS, FollowingCell, spun
from softgrip_testing.waiting import wait_until

OPEN = dict.fromkeys(LONG_FINGERS, (10.0, 8.0, 6.0))
FIST = dict.fromkeys(LONG_FINGERS, (70.0, 90.0, 50.0))
FRAMES, RATE_HZ = 60, 30.0


class ClosingHand:
    """Sees an open hand for 12 frames, then a fist, and calls back after each."""

    name = "drawn"

    def __init__(self, landmarks, seen: Callable[[int], None]) -> None:
        self._landmarks, self._seen, self._count = landmarks, seen, 0

    def find(self, image):
        del image
        self._count += 1
        self._seen(self._count)
        world = self._landmarks(OPEN if self._count <= 12 else FIST)
        return DetectedHand(world, world[:, :2], 1.0)


class TeleoperatedCell(FollowingCell):
    """With all that a person's hand needs of a cell."""

    def __init__(self):
        super().__init__([(StartRecording, "recorder/start"), (StopRecording, "recorder/stop")], tick_s=0.01)
        self.frames, self.heartbeats = [], []
        self.is_homed, self.pressing = True, False
        self.create_subscription(TeleoperationState, "teleoperation/state", self.frames.append, RELIABLE)
        self.create_subscription(LeaseHeartbeat, "tendon/heartbeat", self.heartbeats.append, RELIABLE)
        self._status = self.create_publisher(TendonStatusArray, "tendon/status", SENSOR)
        self._pedal = self.create_publisher(Bool, "teleoperation/dead_man", RELIABLE)
        self._owners = self.create_publisher(TendonOwners, "tendon/owners", LATCHED)
        self._safety = self.create_publisher(SafetyState, "safety/state", LATCHED)
        self._safety.publish(SafetyState())
        self._cell = self.create_publisher(CellState, "cell/state", LATCHED)
        mounted = [MountedFinger(finger=slot, profile="power", state=MountedFinger.VERIFIED) for slot in SLOTS]
        self._cell.publish(CellState(mode=CellState.IDLE, mounted=mounted))

    def show_owner(self, owner):
        self._owners.publish(TendonOwners(owners=[TendonOwner(tendon=slot, owner=owner) for slot in SLOTS]))

    def stop(self):
        self._safety.publish(SafetyState(sequence=1, estop=True, estop_reason="a person"))

    def answer_service(self, name, response):
        if name == "recorder/stop":
            response.path = "out/bags/demonstration"
        return super().answer_service(name, response)

    def publish_more(self):
        self._status.publish(
            TendonStatusArray(tendons=[TendonStatus(tendon=slot, homed=self.is_homed) for slot in SLOTS])
        )
        if self.pressing:
            self._pedal.publish(Bool(data=True))


@pytest.fixture
def cell(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    one = TeleoperatedCell()
    with spun(one) as one.executor_of_test:
        yield one


@pytest.fixture
def film(tmp_path: Path) -> Path:
    for k in range(FRAMES):
        cv2.imwrite(str(tmp_path / f"frame_{k}.png"), np.zeros((4, 4, 3), np.uint8))
    return tmp_path


@pytest.fixture
def follow(cell, film, hand_landmarks):
    node = Node("teleoperate")
    cell.executor_of_test.add_node(node)

    def run(*arguments: str, seen: Callable[[int], None] = lambda _: None) -> int:
        options = parser().parse_args([str(film), *arguments])
        return lead(options, ClosingHand(hand_landmarks, seen), node)

    yield run
    cell.executor_of_test.remove_node(node)
    node.destroy_node()


def test_a_held_switch_lets_the_fingers_follow_and_its_end_stops_them(cell, follow):
    orders_at_release = []

    def seen(count: int) -> None:
        if count == 14:
            cell.pressing = True
        if count == 30:
            cell.pressing = False
        if count == 45:  # 0.5 s later: the last press has long been too old
            orders_at_release.append(len(cell.orders))

    assert follow("--record", "--task", "close", seen=seen) == 0
    assert cell.asked == ["recorder/start", "tendon/lease", "tendon/lease_release", "recorder/stop"]
    assert {order.header.frame_id for order in cell.orders} == {"token"}
    assert {beat.token for beat in cell.heartbeats} == {"token"}
    lengths_m = np.array([order.points[0].positions for order in cell.orders])
    assert np.all(np.diff(lengths_m[:, 0]) >= 0.0)
    assert lengths_m[-1, 0] > 0.003
    assert lengths_m[-1, 2] == pytest.approx(0.0, abs=1e-4)  # the drawn thumb lies still
    wait_until(lambda: bool(cell.frames) and cell.frames[-1].phase == TeleoperationState.ABORTED)
    assert orders_at_release == [len(cell.orders)]
    running = [frame for frame in cell.frames if frame.phase == TeleoperationState.RUNNING]
    assert {(frame.episode, frame.task) for frame in running} == {(1, "close")}
    assert any(frame.duration > 0.0 and frame.is_held for frame in running)
    assert {frame.duration for frame in cell.frames if not frame.is_held} == {0.0}


def test_an_emergency_stop_ends_the_motion(cell, follow):
    orders = []

    def seen(count: int) -> None:
        if count == 14:
            cell.pressing = True
        if count == 25:
            cell.stop()
        if count == 35:
            orders.append(len(cell.orders))

    assert follow(seen=seen) == 0
    assert 0 < orders[0] == len(cell.orders)
    wait_until(lambda: any("emergency stop: a person" in frame.reason for frame in cell.frames))


def test_somebody_elses_tendons_are_left_alone(cell, follow, monkeypatch):
    monkeypatch.setattr(finger_link, "HAND_OVER_TIMEOUT_S", 0.2)
    cell.owner, cell.pressing = "manager", True
    with pytest.raises(DesignError, match="owned by manager"):
        follow()
    assert cell.orders == []


def test_who_loses_the_tendons_stops(cell, follow):
    def seen(count: int) -> None:
        if count == 3:
            cell.show_owner(finger_link.OWNER)
        if count == 20:
            cell.show_owner("manager")

    with pytest.raises(DesignError, match="belong to manager"):
        follow(seen=seen)
    assert cell.asked[-1] == "tendon/lease_release"


def test_what_cannot_begin_says_why(cell, follow):
    with pytest.raises(DesignError, match="expected tendons out of index"):
        follow("--tendons", "ring")
    with pytest.raises(DesignError, match="--profile"):
        follow("--profile", "none")
    cell.is_homed = False
    with pytest.raises(DesignError, match="--home"):
        follow()
    assert "tendon/lease" not in cell.asked
