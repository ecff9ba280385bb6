# SPDX-License-Identifier: Apache-2.0
"""recorder: writes every topic, as it appears, to a bag that explains itself.

Serves recorder/start, recorder/stop, recorder/split and recorder/snapshot. The last seconds are kept in memory whether
a bag is being written or not, and are written by themselves when something fails while none is. Nothing is lost
silently: what publishers sent and never arrived, what the queue to the disk could not hold, and a disk that fails are
counted and reported on /diagnostics.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo

from softgrip_bag import facts
from softgrip_bag.draining import Drain
from softgrip_bag.errors import BagError
from softgrip_bag.faults import FaultWatch
from softgrip_bag.losses import LossCounter
from softgrip_bag.nodes.parameter_snapshot import ParameterSnapshot
from softgrip_bag.nodes.qos import matching, offered
from softgrip_bag.nodes.types import interface_text, message_class
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import RawMessage
from softgrip_bag.repair import repair_all
from softgrip_bag.ring import Ring
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import Attachment, BagWriter, Limits, Topic
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_interfaces.srv import SnapshotRecording, SplitRecording, StartRecording, StopRecording
from softgrip_nodekit import Diagnostics, Health, Parameter, ParameterTable, StartupError, run, with_message_info

PARAMETERS = ParameterTable(
    Parameter("root", "out/bags", "folder for bags that are started without a path"),
    Parameter("path", "", "bag to start recording at once; empty = a new one under root"),
    Parameter("record_on_start", True, "start recording when the node starts"),
    Parameter("repair_on_start", True, "finish bags under root that an earlier recorder could not"),
    Parameter("discovery_period", 0.1, "time between looks for new topics", "s", 0.02, 10.0),
    Parameter("queue_depth", 50000, "messages that a topic may wait in the middleware", "", 1, 1000000),
    Parameter("queue_mb", 256, "messages that may wait for the disk", "MB", 1, 65536),
    Parameter("split_size_mb", 0, "a bag goes on in another file beyond this size; 0 = never", "MB", 0, 1000000),
    Parameter("split_time_s", 0.0, "a bag goes on in another file after this time; 0 = never", "s", 0.0, 1e6),
    Parameter("kept_files", 0, "files of a bag that are kept, the oldest goes; 0 = all", "", 0, 100000),
    Parameter("snapshot_s", 10.0, "time that is kept in memory for recorder/snapshot", "s", 0.0, 3600.0),
    Parameter("snapshot_mb", 64, "most memory for recorder/snapshot", "MB", 0, 65536),
    Parameter(
        "snapshot_on_fault",
        "unrecorded",
        "write the last seconds when a tendon or /diagnostics reports a new fault: never, always, or when no bag is "
        "being written",
        choices=("never", "unrecorded", "always"),
    ),
    Parameter("snapshot_after_s", 2.0, "time after the fault that belongs to its snapshot", "s", 0.0, 60.0),
    Parameter("snapshot_pause_s", 30.0, "least time between two snapshots of faults", "s", 0.0, 3600.0),
)

_MB = 1_000_000
#: [s] Python's 5 ms would let a busy thread keep the middleware's waiting for longer than publishers hold a message.
_SWITCH_INTERVAL = 0.0005
#: [s] longest wait for the thread that writes.
_SPLIT_LIMIT = 30.0
#: [s] longest wait, when a recording is stopped, for what was sent before.
_DRAIN_LIMIT = 20.0
#: [s] after its publication that a message may be taken without a warning.
_LATE = 2.0


def _diagnosed(message: DiagnosticArray) -> dict[str, str]:
    return {s.name: s.message if s.level == DiagnosticStatus.ERROR else "" for s in message.status}


def _tendons(message: TendonStatusArray) -> dict[str, str]:
    wrong = {f"tendon {tendon.tendon}": str(tendon.fault) for tendon in message.tendons}
    return wrong | {"estop": "latched" if message.estop else ""}


#: Types that tell of faults, and how: component -> what is wrong, empty when nothing.
_FAULTS: dict[str, Callable[[Any], dict[str, str]]] = {
    "diagnostic_msgs/msg/DiagnosticArray": _diagnosed,
    "softgrip_interfaces/msg/TendonStatusArray": _tendons,
}


class Recorder(Node):
    """Subscribes raw to whatever is published."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._values = PARAMETERS.declare(self)
        self._limits = Limits(
            self._values["split_size_mb"] * _MB, self._values["split_time_s"], self._values["kept_files"]
        )
        self._bag: Pipeline | None = None
        self._ring = Ring(self._values["snapshot_s"], self._values["snapshot_mb"] * _MB)
        self._fault_watch = FaultWatch(self._values["snapshot_after_s"], self._values["snapshot_pause_s"])
        self._snapshot_thread: threading.Thread | None = None
        self._losses = LossCounter()
        self._lost_before: Counter[str] = Counter()
        self._behind = 0.0  # [s] the latest message since the last report
        self._drain: Drain | None = None
        self._drained: Future = Future()
        self._facts = {"softgrip_machine": facts.machine(), "softgrip_software": facts.software()}
        self._carried: dict[str, Attachment] = {}
        self._topics: dict[str, Topic] = {}
        self._unreadable: dict[str, str] = {}
        self._diagnostics = Diagnostics(self)
        self._repair()
        self._snapshot_of_parameters = ParameterSnapshot(self, self._attach)
        self._snapshot_of_parameters.add_own(self._values)
        self.create_service(StartRecording, "recorder/start", self._on_start)
        # it waits while the other callbacks go on
        own = MutuallyExclusiveCallbackGroup()
        self.create_service(StopRecording, "recorder/stop", self._on_stop, callback_group=own)
        self.create_service(SplitRecording, "recorder/split", self._on_split)
        self.create_service(SnapshotRecording, "recorder/snapshot", self._on_snapshot)
        if self._values["record_on_start"]:
            try:
                self._start(self._values["path"])
            except BagError as error:
                raise StartupError(str(error)) from error
        self.create_timer(self._values["discovery_period"], self._look)
        self._look()

    def close(self) -> None:
        """Finish the bag."""
        if self._snapshot_thread is not None:
            self._snapshot_thread.join()
        if self._bag is not None:
            bag, self._bag = self._bag, None
            bag.close(self._lost())

    def _repair(self) -> None:
        if self._values["repair_on_start"]:
            for result in repair_all(Path(self._values["root"])):
                if isinstance(result, BagError):
                    self.get_logger().error(str(result))
                else:
                    self.get_logger().warning(f"repaired {result}")

    def _folder(self, path: str, prefix: str) -> Path:
        name = datetime.now(UTC).strftime(f"{prefix}_%Y%m%dT%H%M%S_%fZ")
        return Path(path) if path else Path(self._values["root"]) / name

    def _new_bag(self, folder: Path, limits: Limits) -> BagWriter:
        bag = BagWriter(folder, self._facts, limits)
        for attachment in [*self._carried.values()]:
            bag.attach(attachment)
        for topic in [*self._topics.values()]:
            bag.add_topic(topic)
        return bag

    def _start(self, path: str) -> Path:
        folder = self._folder(path, "softgrip")
        try:
            bag = self._new_bag(folder, self._limits)
        except OSError as error:
            raise BagError(f"cannot write {folder}: {error.strerror}; make room or name another folder") from error
        self._bag = Pipeline(bag, self._values["queue_mb"] * _MB)
        self._lost_before = self._losses.lost.copy()
        now = self._now()
        for message in self._ring.latched():
            self._bag.put(message.topic, now, message.published, message.data)
        return folder

    def _on_start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        if self._bag is not None and (self._recording or self._drain is not None):
            response.message = f"expected no running recording, found {self._bag.folder}; stop it first"
            return response
        self.close()
        try:
            response.path = str(self._start(request.path))
            response.success = True
        except BagError as error:
            response.message = str(error)
        return response

    async def _on_stop(self, _: StopRecording.Request, response: StopRecording.Response) -> StopRecording.Response:
        bag = self._bag
        if bag is None or self._drain is not None:
            response.message = "expected a running recording, found " + ("none" if bag is None else "one being stopped")
            return response
        asked = time.time_ns()
        self._drain, self._drained = Drain(asked, asked + int(1e9 * _DRAIN_LIMIT)), Future()
        await self._drained
        self.close()
        response.path = str(bag.folder)
        response.messages = bag.accepted
        response.topics = len(self._topics)
        response.dropped = self._dropped(bag)
        response.success = bag.error is None
        response.message = "" if bag.error is None else f"the disk failed: {bag.error}"
        return response

    def _on_split(self, _: SplitRecording.Request, response: SplitRecording.Response) -> SplitRecording.Response:
        if self._bag is None:
            response.message = "expected a running recording, found none"
            return response
        try:
            response.path = str(self._bag.call(BagWriter.split).result(_SPLIT_LIMIT))
            response.success = True
        except (OSError, TimeoutError) as error:
            response.message = f"{self._bag.folder}: cannot be split: {error or 'the disk is too slow'}"
        return response

    def _on_snapshot(
        self, request: SnapshotRecording.Request, response: SnapshotRecording.Response
    ) -> SnapshotRecording.Response:
        folder = self._folder(request.path, "snapshot")
        messages = self._ring.last(request.seconds)
        try:
            response.path = str(self._write_snapshot(folder, messages))
        except (BagError, OSError) as error:
            response.message = f"{folder}: no snapshot: {error}"
            return response
        response.success, response.messages = True, len(messages)
        return response

    def _write_snapshot(self, folder: Path, messages: Sequence[RawMessage], why: str = "") -> Path:
        bag = self._new_bag(folder, Limits())
        if why:
            bag.add_fact("softgrip_fault", {"fault": why})
        for message in messages:
            bag.write(message.topic, message.received, message.published, message.data)
        return bag.close()

    def _snapshot_of_fault(self) -> None:
        """Write what led to a fault and what followed, on a thread: recording goes on meanwhile."""
        why = self._fault_watch.due(time.monotonic())
        wanted = self._values["snapshot_on_fault"]
        if not why or wanted == "never" or (wanted == "unrecorded" and self._recording):
            return
        folder = self._folder("", "fault")
        messages = self._ring.last()

        def write() -> None:
            try:
                self._write_snapshot(folder, messages, why)
                self.get_logger().warning(f"kept the last seconds in {folder}: {why}")
            except (BagError, OSError) as error:
                self.get_logger().error(f"{folder}: no snapshot of the fault: {error}")

        self._snapshot_thread = threading.Thread(target=write, name="snapshot of a fault")
        self._snapshot_thread.start()

    @property
    def _recording(self) -> bool:
        return self._bag is not None and self._bag.error is None

    def _attach(self, attachment: Attachment) -> None:
        """Take along a node's parameters or a file, in this bag and those to come."""
        self._carried[attachment.name] = attachment
        if self._bag is not None:
            self._bag.call(lambda bag: bag.attach(attachment))

    def _look(self) -> None:
        """Subscribe to topics that have appeared, ask nodes that have."""
        for name, types in self.get_topic_names_and_types():
            if name not in self._topics and name not in self._unreadable and len(types) == 1:
                publishers = self.get_publishers_info_by_topic(name)
                if publishers:
                    self._subscribe(name, types[0], publishers)
        self._snapshot_of_parameters.look()
        self._snapshot_of_fault()
        self._report()
        if self._drain is not None and self._drain.look(time.time_ns()):
            self._drain = None
            self._drained.set_result(None)

    def _report(self) -> None:
        bag = self._bag
        behind, self._behind = self._behind, 0.0
        if bag is None:
            self._diagnostics.set("bag", Health.WARN, "not recording; call recorder/start")
            return
        values = {
            "messages": bag.accepted,
            "dropped": self._dropped(bag),
            "waiting_peak_bytes": bag.peak_bytes,
            "behind_s": round(behind, 3),
            "nodes_with_parameters": self._snapshot_of_parameters.nodes,
            "files_not_found": "; ".join(self._snapshot_of_parameters.missing),
        }
        if bag.error is not None:
            why = bag.error.strerror or bag.error
            said = f"recording stopped: {bag.folder}: {why}; make room, then call recorder/start"
            self._diagnostics.set("bag", Health.ERROR, said, values)
        elif values["dropped"]:
            worst = (self._lost() + bag.dropped).most_common(3)
            said = f"{values['dropped']} messages dropped: " + ", ".join(f"{topic} {n}" for topic, n in worst)
            self._diagnostics.set("bag", Health.WARN, said, values)
        elif behind > _LATE:
            said = f"messages are taken {behind:.1f} s after they were sent: this computer is too busy for the cell"
            self._diagnostics.set("bag", Health.WARN, said, values)
        else:
            self._diagnostics.set("bag", Health.OK, f"recording {bag.folder}", values)

    def _lost(self) -> Counter[str]:
        """Messages that never arrived since the bag was started."""
        return self._losses.lost - self._lost_before

    def _dropped(self, bag: Pipeline) -> int:
        return (self._lost() + bag.dropped).total()

    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

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
            self._bag.call(lambda bag: bag.add_topic(topic))
        simulated = bool(self.get_parameter("use_sim_time").value)
        latched = topic.latched
        faults = _FAULTS.get(type_name)
        single = len(publishers) == 1

        def on_message(data: bytes, info: dict[str, Any]) -> None:
            received = self._now() if simulated else info["received_timestamp"] or time.time_ns()
            message = RawMessage(name, type_name, received, info["source_timestamp"] or received, data)
            publisher = info.get("publisher_gid")
            if publisher is not None or single:
                self._losses.see(name, info["publication_sequence_number"], publisher)
            if not latched:
                self._behind = max(self._behind, 1e-9 * (received - message.published))
            self._ring.add(message, latched=latched)
            if faults is not None:
                self._fault_watch.see(faults(deserialize_message(data, cls)), time.monotonic())
            # a recording ends on all topics at once, so that nothing in it follows from what is not
            wanted = self._drain is None or self._drain.see(message.published)
            if self._bag is not None and wanted:
                self._bag.put(name, received, message.published, data)

        qos = matching(topic.qos, self._values["queue_depth"])
        self.create_subscription(cls, name, with_message_info(on_message), qos, raw=True)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    sys.setswitchinterval(_SWITCH_INTERVAL)
    return run(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
