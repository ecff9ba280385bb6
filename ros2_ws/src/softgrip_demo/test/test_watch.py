# SPDX-License-Identifier: Apache-2.0
"""What the shift keeps of a finger's predictions."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from softgrip_demo.nodes.watch import ShiftWatch
from softgrip_interfaces.msg import FingerState, FingerStates


class Subscriptions:
    """Stands where a node does: keeps what is subscribed to."""

    def __init__(self) -> None:
        self.by_topic: dict[str, Any] = {}

    def create_subscription(self, _: Any, topic: str, callback: Any, *__: Any, raw: bool) -> None:
        assert raw
        self.by_topic[topic] = callback

    def receive(self, topic: str, message: Any) -> None:
        self.by_topic[topic](serialize_message(message))


def test_a_prediction_is_kept_with_its_deviations_and_the_tension_of_its_time() -> None:
    node = Subscriptions()
    watch = ShiftWatch(node, "index")  # type: ignore[arg-type]
    watch.start_gathering()
    tendons = JointState(name=["thumb", "index"], effort=[9.0, 4.0])
    tendons.header.stamp.sec = 7
    node.receive("tendon/state", tendons)
    index = FingerState(finger="index", pulled_length=0.01, tension=5.0, joint_angles=[0.1, 0.2])
    index.tip.x, index.tip.y = 0.09, -0.02
    index.tip_stddev = [0.001, 0.003]
    states = FingerStates(fingers=[FingerState(finger="thumb"), index])
    states.header.stamp.sec = 7
    node.receive("finger/predicted", states)
    (kept,) = watch.end().predicted
    assert (kept.stamp, kept.pulled_length_m, kept.tension, kept.predicted_tension) == (7.0, 0.01, 4.0, 5.0)
    assert (kept.tip, kept.tip_stddev) == ((0.09, -0.02), (0.001, 0.003))
    assert kept.angles == pytest.approx((0.1, 0.2))


def test_a_failed_prediction_is_not_kept() -> None:
    node = Subscriptions()
    watch = ShiftWatch(node, "index")  # type: ignore[arg-type]
    watch.start_gathering()
    failed = FingerState(finger="index", validity=FingerState.FAILED)
    node.receive("finger/predicted", FingerStates(fingers=[failed]))
    assert watch.end().predicted == []
