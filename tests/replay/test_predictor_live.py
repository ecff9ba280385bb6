# SPDX-License-Identifier: Apache-2.0
"""kinematics_predictor recorded while it works, with inputs in time and inputs that come late, and replayed."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from softgrip_bag.nodes.replay import check
from softgrip_bag.reader import read, topic_summaries
from softgrip_interfaces.msg import CellState, FingerStates, FrictionModel, InputNote, MountedFinger
from softgrip_nodekit import LATCHED, SENSOR, nanoseconds, to_time_message
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.node_processes import Peer, node_processes, peer_node

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
PROFILES = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/profiles"
SLOTS = ("index", "middle", "thumb")
SECOND = 1_000_000_000


def friction(name: str, since_ns: int) -> FrictionModel:
    return FrictionModel(
        id=name,
        activated=to_time_message(since_ns),
        law="matte",
        k_reading="printed",
        coefficient_names=["alpha", "n", "epsilon", "lambda"],
        coefficients=[0.3, 0.82038, 0.06483, 0.00851],
        cable_radius=0.000125,
        surface_radius=0.003,
        angle_range=[0.1745, 1.5708],
        tension_range=[1.962, 9.81],
        verdict=FrictionModel.USABLE,
    )


def mounted(profile: str, since_ns: int) -> CellState:
    fingers = [MountedFinger(finger=slot, profile=profile, state=MountedFinger.VERIFIED) for slot in SLOTS]
    message = CellState(mounted=fingers)
    message.header.stamp = to_time_message(since_ns)
    return message


class Cell:
    """What the predictor hears."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._tendons = peer.node.create_publisher(JointState, "tendon/state", SENSOR)
        self.friction = peer.node.create_publisher(FrictionModel, "friction/active", LATCHED)
        self.state = peer.node.create_publisher(CellState, "cell/state", LATCHED)
        self.predicted: list[FingerStates] = peer.hear(FingerStates, "finger/predicted", SENSOR)
        self._pulled_length_m = 0.0

    def drive_until(self, condition: Any) -> None:
        """Send tendon states, a hundred a second at most, until something has come of them."""

        def driven() -> bool:
            self._pulled_length_m = (self._pulled_length_m + 1e-4) % 0.012
            message = JointState(
                name=list(SLOTS), position=[self._pulled_length_m] * 3, velocity=[0.01] * 3, effort=[5.0] * 3
            )
            message.header.stamp = to_time_message(time.time_ns())
            self._tendons.publish(message)
            time.sleep(0.01)
            return bool(condition())

        self._peer.spin_until(driven)

    def is_used(self, model: str, profile: str) -> bool:
        last = self.predicted[-1] if self.predicted else FingerStates()
        return last.friction_model == model and all(finger.profile == profile for finger in last.fingers)


def test_a_predictor_s_bag_is_replayed_with_what_came_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    bag = tmp_path / "bag"
    with (
        node_processes("softgrip_bag.nodes.recorder", [f"root:={tmp_path}", f"path:={bag}", "reserve_mb:=0"]) as record,
        node_processes("softgrip_model.nodes.kinematics_predictor", [f"profiles_directory:={PROFILES}"]) as predict,
        peer_node("cell") as peer,
    ):
        cell = Cell(peer)
        recorder, predictor = record(), predict()
        cell.drive_until(lambda: cell.is_used("braid-tpu-chapter4", "power"))
        cell.friction.publish(friction("in-time", time.time_ns()))
        cell.drive_until(lambda: cell.is_used("in-time", "power"))
        cell.state.publish(mounted("pinch", time.time_ns() - SECOND))  # late
        cell.friction.publish(friction("late", time.time_ns() - SECOND))
        cell.drive_until(lambda: cell.is_used("late", "pinch"))
        cell.state.publish(mounted("hook", time.time_ns()))
        cell.drive_until(lambda: cell.is_used("late", "hook"))
        cell.drive_until(lambda: len(recorded(bag)) >= 3)
        for process in (predictor, recorder):
            process.send_signal(signal.SIGINT)
            assert process.wait(60.0) == 0, process.stderr.read() if process.stderr else ""
    notes = recorded(bag)
    assert {note.topic for note in notes} == {"/tendon/state", "/friction/active", "/cell/state"}
    assert all(nanoseconds(note.after) > nanoseconds(note.header.stamp) for note in notes[1:])
    found = check(bag, "kinematics_predictor")
    assert found.divergence is None, str(found.divergence)
    assert found.compared > 10


def recorded(bag: Path) -> list[InputNote]:
    """Return the notes that are in the bag by now, and before its fourth topic none."""
    if not list(bag.glob("*.mcap")) or len(topic_summaries(bag)) < 4:
        return []
    return [deserialize_message(raw.data, InputNote) for raw in read(bag, {"/kinematics_predictor/input_notes"})]
