# SPDX-License-Identifier: Apache-2.0
"""Feed a bag through a node's own code, without middleware, and collect what it publishes.

The node is constructed as it is; only its publishers are replaced by lists and its timers by nothing, so that its
outputs depend on the messages fed in and on nothing else.
"""

from __future__ import annotations

import importlib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.serialization import deserialize_message

from softgrip_bag.comparison import MEASURES_OF_THE_MACHINE, Divergence, Result, first_difference
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.types import message_class
from softgrip_bag.reader import RawMessage, read, topic_types

#: Nodes whose outputs depend on their inputs and the inputs' stamps only (docs/conventions.md).
NODES = {
    "kinematics_predictor": "softgrip_model.nodes.kinematics_predictor:KinematicsPredictor",
    "gdfe_simulator": "softgrip_model.nodes.gdfe_simulator:GdfeSimulator",
    "marker_tracker": "softgrip_vision.nodes.marker_tracker:MarkerTracker",
    "grasp_mix_manager": "softgrip_cell.nodes.grasp_mix_manager:GraspMixManager",
}
#: Topics of every node that are no results of it.
NOT_RESULTS = {"/rosout", "/parameter_events", "/diagnostics"}


class _CapturingPublisher:
    def __init__(self, topic: str, sink: dict[str, list[Any]]) -> None:
        self.topic_name = topic
        self._sink = sink

    def publish(self, message: Any) -> None:
        self._sink[self.topic_name].append(message)

    def get_subscription_count(self) -> int:
        return 1


class _StoppedTimer:
    def cancel(self) -> None:
        """Nothing runs."""

    def reset(self) -> None:
        """Nothing runs."""


class ReplayedNode:
    """A node whose subscriptions are called by hand."""

    def __init__(self, name: str, ros_arguments: Sequence[str] = ()) -> None:
        if name not in NODES:
            raise BagError(f"expected one of {', '.join(NODES)}, found {name!r}")
        module, _, class_name = NODES[name].partition(":")
        base = getattr(importlib.import_module(module), class_name)
        sink: dict[str, list[Any]] = defaultdict(list)

        class Captured(base):  # type: ignore[misc, valid-type]  # the class is chosen at run time
            def create_publisher(self, msg_type: Any, topic: str, qos: Any, **options: Any) -> Any:
                if not hasattr(self, "_ready_to_capture"):
                    return super().create_publisher(msg_type, topic, qos, **options)
                return _CapturingPublisher(self.resolve_topic_name(topic), sink)

            def create_timer(self, *_: Any, **__: Any) -> Any:
                return _StoppedTimer()

        Captured._ready_to_capture = True  # type: ignore[attr-defined]  # noqa: SLF001
        rclpy.init(args=["--ros-args", *ros_arguments] if ros_arguments else None)
        self.node = Captured()
        self._sink = sink
        self._callbacks = {s.topic_name: (s.callback, s.msg_type) for s in self.node.subscriptions}

    @property
    def inputs(self) -> set[str]:
        """Topics that the node subscribes to."""
        return set(self._callbacks)

    def feed(self, message: RawMessage) -> list[tuple[str, Any]]:
        """Call the node's callback with one recorded message; returns what it published (topic, message)."""
        callback, message_type = self._callbacks[message.topic]
        callback(deserialize_message(message.data, message_type))
        published = [(topic, output) for topic, outputs in self._sink.items() for output in outputs]
        self._sink.clear()
        return published

    def close(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()
        rclpy.try_shutdown()


def tree(message: Any) -> Any:
    """Return a message as nested dicts and lists of plain values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: tree(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)):
        return [tree(item) for item in message]
    return message


def check(bag: Path, name: str, ros_arguments: Sequence[str] = ()) -> Result:
    """Feed a bag through a node and compare every output with the recorded one."""
    types = topic_types(bag)
    node = ReplayedNode(name, ros_arguments)
    try:
        replayed: dict[str, list[Any]] = defaultdict(list)
        for message in read(bag, node.inputs & set(types)):
            for topic, output in node.feed(message):
                replayed[topic].append(output)
        return _compare(bag, {t: o for t, o in replayed.items() if t in types and t not in NOT_RESULTS}, types)
    finally:
        node.close()


def _compare(bag: Path, replayed: dict[str, list[Any]], types: dict[str, str]) -> Result:
    by_key = {topic: {_key(message): message for message in messages} for topic, messages in replayed.items()}
    compared = 0
    for raw in read(bag, set(by_key)):
        recorded = deserialize_message(raw.data, message_class(raw.type_name))
        stamp = _key(recorded)
        output = by_key[raw.topic].get(stamp)
        compared += 1
        if output is None:
            return Result(compared, Divergence(raw.topic, stamp[0], "(message)", "published", "not published"))
        skip = MEASURES_OF_THE_MACHINE.get(types[raw.topic], frozenset())
        found = first_difference(tree(recorded), tree(output), skip)
        if found:
            return Result(compared, Divergence(raw.topic, stamp[0], *found))
    return Result(compared, None)


def _key(message: Any) -> tuple[int, str]:
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec, getattr(message, "finger", "")
