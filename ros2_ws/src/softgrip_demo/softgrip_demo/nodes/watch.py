# SPDX-License-Identifier: Apache-2.0
"""What the shift looks at while the cell works: measured and predicted fingers, tensions, shapes, frames."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, JointState

from softgrip_demo.alignment import Instant, Measured
from softgrip_interfaces.msg import FingerStates, PredictedShape
from softgrip_nodekit import SENSOR, seconds


@dataclass
class Gathered:
    """What was seen since the last ``begin``."""

    measured: list[Measured] = field(default_factory=list)
    predicted: list[Instant] = field(default_factory=list)
    shapes: list[Any] = field(default_factory=list)
    frames: list[tuple[float, bytes]] = field(default_factory=list)


class Watch:
    """Subscribes to the watched finger; gathers while ``gathering`` is set."""

    def __init__(self, node: Node, finger: str) -> None:
        self.finger = finger
        self.seen: set[str] = set()
        self._gathered: Gathered | None = None
        self._film = False
        self._tensions: deque[tuple[float, float]] = deque(maxlen=4000)
        node.create_subscription(JointState, "tendon/state", self._on_tendon, SENSOR)
        node.create_subscription(FingerStates, "finger/measured", self._on_measured, SENSOR)
        node.create_subscription(FingerStates, "finger/predicted", self._on_predicted, SENSOR)
        node.create_subscription(PredictedShape, "shape/predicted", self._on_shape, SENSOR)
        node.create_subscription(CompressedImage, "camera/image_raw/compressed", self._on_frame, SENSOR)

    def begin(self, *, film: bool = False) -> None:
        """Start gathering; with ``film`` camera frames too."""
        self._gathered, self._film = Gathered(), film

    def end(self) -> Gathered:
        """Stop gathering and return what was seen."""
        gathered = self._gathered or Gathered()
        self._gathered, self._film = None, False
        return gathered

    @property
    def gathered(self) -> Gathered:
        """What was seen so far, empty when nothing is being gathered."""
        return self._gathered or Gathered()

    def _on_tendon(self, message: JointState) -> None:
        self.seen.add("tendon/state")
        if self.finger in message.name:
            tension = message.effort[list(message.name).index(self.finger)]
            self._tensions.append((seconds(message.header.stamp), tension))

    def _on_measured(self, message: FingerStates) -> None:
        self.seen.add("finger/measured")
        if self._gathered is None:
            return
        stamp = seconds(message.header.stamp)
        self._gathered.measured += [
            Measured(stamp, tuple(state.joint_angles), (state.tip.x, state.tip.y))
            for state in message.fingers
            if state.finger == self.finger and state.validity != state.FAILED
        ]

    def _on_predicted(self, message: FingerStates) -> None:
        self.seen.add("finger/predicted")
        if self._gathered is None:
            return
        stamp = seconds(message.header.stamp)
        self._gathered.predicted += [
            Instant(
                stamp=stamp,
                pulled_length=state.pulled_length,
                angles=tuple(state.joint_angles),
                tip=(state.tip.x, state.tip.y),
                predicted_tension=state.tension,
                tension=self._tension_at(stamp),
            )
            for state in message.fingers
            if state.finger == self.finger and state.validity != state.FAILED
        ]

    def _on_shape(self, message: PredictedShape) -> None:
        self.seen.add("shape/predicted")
        if self._gathered is not None and message.finger == self.finger:
            self._gathered.shapes.append(message)

    def _on_frame(self, message: CompressedImage) -> None:
        self.seen.add("camera/image_raw/compressed")
        if self._gathered is not None and self._film:
            self._gathered.frames.append((seconds(message.header.stamp), bytes(message.data)))

    def _tension_at(self, stamp: float) -> float:
        for at, tension in reversed(self._tensions):
            if at <= stamp:
                return tension
        return float("nan")
