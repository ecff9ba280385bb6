# SPDX-License-Identifier: Apache-2.0
"""A node under its own code but without middleware: messages are handed to it, and what it publishes is kept.

The node is constructed as it is; only its publishers are replaced by lists and its timers by nothing, so that its
outputs depend on the messages fed in and on nothing else.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.reader import RawMessage

#: Topics that rclpy itself publishes for a node.
INFRASTRUCTURE = {"/rosout", "/parameter_events"}


@dataclass(frozen=True)
class Output:
    """What a node published, in the wire's form: float32 fields are only there what they were recorded as."""

    topic: str
    kind: type[object]
    data: bytes

    @property
    def message(self) -> Any:
        """The message, read back."""
        return deserialize_message(self.data, self.kind)


@dataclass(frozen=True)
class Fed:
    """What a node said to what it was fed.

    Attributes:
        outputs: topic -> messages.
        start: [ns] stamp from which on they are complete: what hangs on messages older than the bag cannot come out.
        stamps: [ns] of every message that was fed: an output keeps the stamp of its input.
        topics: that it can publish on, those included on which it said nothing.
        end: [ns] stamp of the last one that is complete; None = all are.
    """

    outputs: Mapping[str, Sequence[Output]]
    start: int
    stamps: AbstractSet[int]
    topics: AbstractSet[str]
    end: int | None = None


class _CapturingPublisher:
    def __init__(self, topic: str, sink: list[Output]) -> None:
        self.topic_name = topic
        self._sink = sink

    def publish(self, message: object) -> None:
        self._sink.append(Output(self.topic_name, type(message), bytes(serialize_message(message))))

    def get_subscription_count(self) -> int:
        return 1


class _StoppedTimer:
    def cancel(self) -> None:
        """Nothing runs."""

    def reset(self) -> None:
        """Nothing runs."""


class ReplayedNode:
    """A node whose subscriptions are called by hand; rclpy has to be initialised.

    Args:
        class_path: module:class.
        options: of its constructor.
    """

    def __init__(self, class_path: str, **options: Any) -> None:
        module, _, class_name = class_path.partition(":")
        base = getattr(importlib.import_module(module), class_name)
        sink: list[Output] = []
        #: topics that it can publish on, rclpy's own left out
        self.topics: set[str] = set()
        topics = self.topics

        class Captured(base):  # type: ignore[misc, valid-type]  # the class is chosen at run time
            def create_publisher(self, msg_type: Any, topic: str, qos: Any, **options: Any) -> Any:
                name = topic if topic.startswith("/") else self.resolve_topic_name(topic)
                if name in INFRASTRUCTURE:
                    return super().create_publisher(msg_type, topic, qos, **options)
                topics.add(name)
                return _CapturingPublisher(name, sink)

            def create_timer(self, *_: object, **__: object) -> _StoppedTimer:
                return _StoppedTimer()

        self.node = Captured(**options)
        self._sink = sink
        self._callbacks = {s.topic_name: (s.callback, s.msg_type) for s in self.node.subscriptions}

    @property
    def name(self) -> str:
        """Its name with its namespace."""
        return str(self.node.get_fully_qualified_name())

    @property
    def inputs(self) -> set[str]:
        """Topics that the node subscribes to."""
        return set(self._callbacks)

    def feed(self, message: RawMessage) -> list[Output]:
        """Call the node's callback with one recorded message; returns what it published."""
        callback, message_type = self._callbacks[message.topic]
        callback(deserialize_message(message.data, message_type))
        return self.published()

    def published(self) -> list[Output]:
        """Return what the node published since the last time."""
        published = self._sink.copy()
        self._sink.clear()
        return published

    def close(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()
