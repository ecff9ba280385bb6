# SPDX-License-Identifier: Apache-2.0
"""recorder: writes every topic, as it appears, to a bag that explains itself."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.types import interface_text, message_class
from softgrip_bag.qos_text import OfferedQos
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.srv import StartRecording, StopRecording
from softgrip_nodekit import Diagnostics, Health, Parameter, ParameterTable, StartupError, run

PARAMETERS = ParameterTable(
    Parameter("root", "out/bags", "folder for bags that are started without a path"),
    Parameter("path", "", "bag to start recording at once; empty = a new one under root"),
    Parameter("record_on_start", True, "start recording when the node starts"),
    Parameter("discovery_period", 0.1, "time between looks for new topics", "s", 0.02, 10.0),
    Parameter("queue_depth", 1000, "messages that a topic may wait in the middleware", "", 1, 100000),
)


class Recorder(Node):
    """Subscribes raw to whatever is published."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._values = PARAMETERS.declare(self)
        self._bag: BagWriter | None = None
        self._subscriptions_by_topic: dict[str, Any] = {}
        self._topics: dict[str, Topic] = {}
        self._unreadable: dict[str, str] = {}
        self._diagnostics = Diagnostics(self)
        self.create_service(StartRecording, "recorder/start", self._on_start)
        self.create_service(StopRecording, "recorder/stop", self._on_stop)
        if self._values["record_on_start"]:
            try:
                self._start(self._values["path"])
            except BagError as error:
                raise StartupError(str(error)) from error
        self.create_timer(self._values["discovery_period"], self._look)
        self._look()

    def close(self) -> None:
        """Finish the bag."""
        if self._bag is not None:
            bag, self._bag = self._bag, None
            bag.close()

    def _start(self, path: str) -> Path:
        name = datetime.now(UTC).strftime("softgrip_%Y%m%dT%H%M%S_%fZ")
        folder = Path(path) if path else Path(self._values["root"]) / name
        bag = BagWriter(folder, {"softgrip_machine": machine_facts()})
        for topic in self._topics.values():
            bag.add_topic(Topic(topic.name, topic.type_name, topic.type_hash, topic.schema, topic.qos))
        self._bag = bag
        return folder

    def _on_start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        if self._bag is not None:
            response.message = f"expected no running recording, found {self._bag.folder}; stop it first"
            return response
        try:
            response.path = str(self._start(request.path))
            response.success = True
        except BagError as error:
            response.message = str(error)
        return response

    def _on_stop(self, _: StopRecording.Request, response: StopRecording.Response) -> StopRecording.Response:
        if self._bag is None:
            response.message = "expected a running recording, found none"
            return response
        bag = self._bag
        response.messages = bag.messages
        response.topics = len(bag.topics)
        response.path = str(bag.folder)
        self.close()
        response.success = True
        return response

    def _look(self) -> None:
        """Subscribe to topics that have appeared; hand to disk what is due."""
        for name, types in self.get_topic_names_and_types():
            if name not in self._subscriptions_by_topic and name not in self._unreadable and len(types) == 1:
                publishers = self.get_publishers_info_by_topic(name)
                if publishers:
                    self._subscribe(name, types[0], publishers)
        if self._bag is not None:
            self._bag.flush_if_due()
            self._diagnostics.set("bag", Health.OK, f"recording {self._bag.folder}", {"messages": self._bag.messages})
        else:
            self._diagnostics.set("bag", Health.WARN, "not recording; call recorder/start")

    def _subscribe(self, name: str, type_name: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        try:
            topic = Topic(
                name,
                type_name,
                str(publishers[0].topic_type_hash),
                schema_text(type_name, interface_text),
                tuple(offered(info.qos_profile) for info in publishers),
            )
            cls = message_class(type_name)
        except BagError as error:
            self._unreadable[name] = str(error)
            self._diagnostics.set(name, Health.ERROR, f"not recorded: {error}")
            return
        self._topics[name] = topic
        if self._bag is not None:
            self._bag.add_topic(topic)

        def on_message(data: bytes, info: dict[str, int]) -> None:
            if self._bag is not None:
                received = self.get_clock().now().nanoseconds
                self._bag.write(name, received, int(info["source_timestamp"]) or received, data)

        qos = matching(topic.qos, self._values["queue_depth"])
        self._subscriptions_by_topic[name] = self.create_subscription(cls, name, on_message, qos, raw=True)


def offered(profile: QoSProfile) -> OfferedQos:
    """Return a publisher's QoS as the bag stores it."""
    return OfferedQos(
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        history="keep_all" if profile.history == HistoryPolicy.KEEP_ALL else "keep_last",
        depth=int(profile.depth),
    )


def matching(qos: Sequence[OfferedQos], depth: int) -> QoSProfile:
    """Return a subscription's QoS that every one of the publishers can serve."""
    reliable = all(o.reliability == "reliable" for o in qos)
    latched = all(o.durability == "transient_local" for o in qos)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def machine_facts() -> dict[str, str]:
    """Return what identifies the machine and its Python."""
    return {"system": platform.platform(), "machine": platform.machine(), "python": platform.python_version()}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
