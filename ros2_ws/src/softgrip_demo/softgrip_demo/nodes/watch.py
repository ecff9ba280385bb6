# SPDX-License-Identifier: Apache-2.0
"""What the shift looks at while the cell works: measured and predicted fingers, tensions, shapes, frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, JointState

from softgrip_demo.alignment import Instant, MeasuredTip
from softgrip_interfaces.msg import FingerStates, PredictedShape
from softgrip_nodekit import SENSOR, seconds

Message = TypeVar("Message")


@dataclass
class Gathered:
    """What was seen since the last ``begin``."""

    measured: list[MeasuredTip] = field(default_factory=list)
    predicted: list[Instant] = field(default_factory=list)
    shapes: list[PredictedShape] = field(default_factory=list)
    frames: list[tuple[float, bytes]] = field(default_factory=list)


#: Tensions from before ``begin`` that the first predictions after it may belong to.
EARLIER_TENSIONS = 50


class ShiftWatch:
    """Subscribes to the watched finger; gathers between ``begin`` and ``end``, and reads nothing in between."""

    def __init__(self, node: Node, finger: str) -> None:
        self.finger = finger
        self.seen: set[str] = set()
        self._gathered: Gathered | None = None
        self._film = False
        self._earlier: deque[bytes] = deque(maxlen=EARLIER_TENSIONS)
        self._tensions: list[tuple[float, float]] = []
        self._subscribe(node, FingerStates, "finger/measured", self._on_measured)
        self._subscribe(node, FingerStates, "finger/predicted", self._on_predicted)
        self._subscribe(node, PredictedShape, "shape/predicted", self._on_shape)
        self._subscribe(node, CompressedImage, "camera/image_raw/compressed", self._on_frame)
        node.create_subscription(JointState, "tendon/state", self._on_tendon, SENSOR, raw=True)

    def _subscribe(
        self, node: Node, kind: type[Message], topic: str, gather: Callable[[Gathered, Message], None]
    ) -> None:
        def received(data: bytes) -> None:
            self.seen.add(topic)
            if self._gathered is not None and (kind is not CompressedImage or self._film):
                gather(self._gathered, deserialize_message(data, kind))

        node.create_subscription(kind, topic, received, SENSOR, raw=True)

    def start_gathering(self, *, film: bool = False) -> None:
        """Start gathering; with ``film`` camera frames too."""
        self._tensions.clear()
        for data in self._earlier:
            self._take_tension(data)
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

    def _on_tendon(self, data: bytes) -> None:
        self.seen.add("tendon/state")
        self._earlier.append(data)
        if self._gathered is not None:
            self._take_tension(data)

    def _take_tension(self, data: bytes) -> None:
        message = deserialize_message(data, JointState)
        if self.finger in message.name:
            tension = message.effort[list(message.name).index(self.finger)]
            self._tensions.append((seconds(message.header.stamp), tension))

    def _on_measured(self, gathered: Gathered, message: FingerStates) -> None:
        stamp = seconds(message.header.stamp)
        gathered.measured += [
            MeasuredTip(
                stamp, tuple(state.joint_angles), (state.tip.x, state.tip.y), (state.tip_stddev[0], state.tip_stddev[1])
            )
            for state in message.fingers
            if state.finger == self.finger and state.validity != state.FAILED
        ]

    def _on_predicted(self, gathered: Gathered, message: FingerStates) -> None:
        stamp = seconds(message.header.stamp)
        gathered.predicted += [
            Instant(
                stamp=stamp,
                pulled_length_m=state.pulled_length,
                angles=tuple(state.joint_angles),
                tip=(state.tip.x, state.tip.y),
                predicted_tension=state.tension,
                tension=self._tension_at(stamp),
                tip_stddev=(float(state.tip_stddev[0]), float(state.tip_stddev[1])),
            )
            for state in message.fingers
            if state.finger == self.finger and state.validity != state.FAILED
        ]

    def _on_shape(self, gathered: Gathered, message: PredictedShape) -> None:
        if message.finger == self.finger:
            gathered.shapes.append(message)

    def _on_frame(self, gathered: Gathered, message: CompressedImage) -> None:
        gathered.frames.append((seconds(message.header.stamp), bytes(message.data)))

    def _tension_at(self, stamp: float) -> float:
        for at, tension in reversed(self._tensions):
            if at <= stamp:
                return tension
        return float("nan")
