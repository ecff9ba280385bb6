# SPDX-License-Identifier: Apache-2.0
"""recorder: writes every topic, as it appears, to a bag that explains itself.

Serves recorder/start, recorder/stop, recorder/split and recorder/snapshot. The last seconds are kept in memory whether
a bag is being written or not, and are written by themselves when something fails while none is. Nothing is lost
silently: what publishers sent and never arrived, what the queue to the disk could not hold, and a disk that fails are
counted and reported on /diagnostics. It writes below its root only, leaves a reserve of the disk free, and reads files
that parameters name only below attachment_roots.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo

from softgrip_bag.arrivals import Drain, LossCounter
from softgrip_bag.cell_namespace import is_below, is_of_cell, is_shared
from softgrip_bag.context import machine, software
from softgrip_bag.errors import BagError, DiskError, error_text
from softgrip_bag.mcap_stream import MAX_ID
from softgrip_bag.nodes.messages import interface_text, message_class
from softgrip_bag.nodes.parameter_snapshot import PARAMETER_EVENT, ParameterSnapshot, without_secrets
from softgrip_bag.nodes.qos import matching, offered
from softgrip_bag.offers import publishers_type, type_conflict
from softgrip_bag.pipeline import Pipeline, free_bytes
from softgrip_bag.places import bag_folder
from softgrip_bag.reader import RawMessage
from softgrip_bag.repair import bags_in, repair_all
from softgrip_bag.schema_text import schema_text
from softgrip_bag.snapshot import FaultWatch, Ring, snapshot_seconds
from softgrip_bag.writer import Attachment, BagWriter, FileLimits, Topic, clamp_stamp
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_interfaces.srv import SnapshotRecording, SplitRecording, StartRecording, StopRecording
from softgrip_nodekit import (
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    StartupError,
    run,
    with_message_info,
)
from softgrip_time.units import to_ns, to_s

if TYPE_CHECKING:
    from rclpy.subscription import MessageInfo

PARAMETERS = ParameterTable(
    Parameter("root", "out/bags", "folder that all bags asked for by services are below"),
    Parameter("path", "", "bag to start recording at once; empty = a new one under root"),
    Parameter("record_on_start", True, "start recording when the node starts"),
    Parameter("repair_on_start", True, "finish bags under root that an earlier recorder could not"),
    Parameter("discovery_period", 0.1, "time between looks for new topics", "s", 0.02, 10.0),
    Parameter("queue_depth", 50000, "messages that a topic may wait in the middleware", "", 1, 1000000),
    Parameter("queue_mb", 256, "messages that may wait for the disk", "MB", 1, 65536),
    Parameter("reserve_mb", 500, "room on the disk that a recording leaves free: it ends before", "MB", 0, 1000000),
    Parameter("split_size_mb", 1000, "a bag goes on in another file beyond this size; 0 = never", "MB", 0, 1000000),
    Parameter("split_time_s", 0.0, "a bag goes on in another file after this time; 0 = never", "s", 0.0, 1e6),
    Parameter("kept_files", 50, "files of a bag that are kept, the oldest goes; 0 = all", "", 0, 100000),
    Parameter(
        "attachment_roots",
        ".",
        "folders (or files), separated by ':', that files named by nodes' parameters may be below to go into the bag",
    ),
    Parameter("snapshot_s", 10.0, "time that is kept in memory for recorder/snapshot", "s", 0.0, 3600.0),
    Parameter("snapshot_mb", 48, "most memory for recorder/snapshot", "MB", 0, 65536),
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
#: [byte] all attachments of a bag together; they come from anybody's parameters.
_MAX_CARRIED = 64 * _MB
#: [s] Python's 5 ms would let a busy thread keep the middleware's waiting for longer than publishers hold a message.
_SWITCH_INTERVAL = 0.0005
#: [s] longest wait for the thread that writes.
_SPLIT_LIMIT = 30.0
#: [s] longest wait, when a recording is stopped, for what was sent before.
_DRAIN_LIMIT = 20.0
#: Problems with topics that are named on /diagnostics.
_SHOWN = 10
#: [s] after its publication that a message may be taken without a warning.
_LATE = 2.0


_OnMessage = Callable[[bytes, "MessageInfo"], None]


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


class Recorder(CellNode):
    """Subscribes raw to whatever is published."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._cell = self.get_namespace()
        self._values = PARAMETERS.declare(self)
        self._limits = FileLimits(
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
        self._drained: Future[None] = Future()
        self._facts = {"softgrip_machine": machine(), "softgrip_software": software()}
        self._carried: dict[str, Attachment] = {}
        self._topics: dict[str, Topic] = {}
        self._unreadable: dict[str, str] = {}
        self._conflicts: dict[str, str] = {}  # topics with more than one type
        self._malformed: Counter[str] = Counter()  # messages that are not of their topic's type
        self._bad_stamps = 0
        self._not_started = ""
        self._diagnostics = Diagnostics(self)
        self._is_closing = threading.Event()
        self._repair()
        roots = [Path(root) for root in str(self._values["attachment_roots"]).split(os.pathsep) if root]
        self._snapshot_of_parameters = ParameterSnapshot(self, self._attach, roots)
        self._snapshot_of_parameters.add_own(self._values)
        self.create_service(StartRecording, "recorder/start", self._on_start)
        # it waits while the other callbacks go on
        own = MutuallyExclusiveCallbackGroup()
        self.create_service(StopRecording, "recorder/stop", self._on_stop, callback_group=own)
        self.create_service(SplitRecording, "recorder/split", self._on_split)
        self.create_service(SnapshotRecording, "recorder/snapshot", self._on_snapshot)
        try:
            if self._values["record_on_start"]:
                self._start_at_once()
            self.create_timer(self._values["discovery_period"], self._look)
            self._look()
        except BaseException:  # a signal, too: nobody closes a node that was never finished
            self._end_recording()
            raise

    def close(self) -> None:
        """Finish the bag."""
        self._is_closing.set()
        self._snapshot_of_parameters.close()
        self._end_recording()

    def _end_recording(self) -> None:
        if self._snapshot_thread is not None:
            self._snapshot_thread.join()
        if self._bag is not None:
            bag, self._bag = self._bag, None
            bag.close(self._lost())

    def _start_at_once(self) -> None:
        """Begin the recording asked for at start. A full disk does not end the node: the cell would go with it."""
        path = str(self._values["path"])
        try:
            self._start(Path(path) if path else self._folder("", "softgrip"))
        except DiskError as error:
            self._not_started = str(error)
        except BagError as error:
            raise StartupError(str(error)) from error

    def _repair(self) -> None:
        """Repair what is there now, on a thread: a large bag takes minutes, and the recording begins at once."""
        if not self._values["repair_on_start"]:
            return
        bags = bags_in(Path(self._values["root"]))

        def work() -> None:
            for result in repair_all(bags, self._is_closing.is_set):
                if isinstance(result, BagError):
                    self.get_logger().error(str(result))
                else:
                    self.get_logger().warning(f"repaired {result}")

        threading.Thread(target=work, name="repair", daemon=True).start()

    def _folder(self, path: str, prefix: str) -> Path:
        name = datetime.now(UTC).strftime(f"{prefix}_%Y%m%dT%H%M%S_%fZ")
        return bag_folder(Path(self._values["root"]), path or name)

    def _check_reserve(self, folder: Path, more: int = 0) -> None:
        """Refuse a bag that the disk has no room for.

        Raises:
            DiskError: less than the reserve and ``more`` bytes is free.
        """
        there = next(place for place in (folder, *folder.parents) if place.is_dir())
        expected = self._values["reserve_mb"] * _MB + more
        free = free_bytes(there)
        if self._values["reserve_mb"] and free < expected:
            raise DiskError(
                f"{folder}: expected at least {expected / _MB:.0f} MB of room on the disk (reserve_mb), found "
                f"{free / _MB:.0f} MB; delete bags, or name another root"
            )

    def _new_bag(self, folder: Path, limits: FileLimits) -> BagWriter:
        bag = BagWriter(folder, self._facts, limits)
        for attachment in [*self._carried.values()]:
            bag.attach(attachment)
        for topic in [*self._topics.values()]:
            bag.add_topic(topic)
        return bag

    def _start(self, folder: Path) -> Path:
        try:
            self._check_reserve(folder)
            bag = self._new_bag(folder, self._limits)
        except OSError as error:
            raise DiskError(f"cannot write {folder}: {error.strerror}; make room or name another folder") from error
        self._not_started = ""
        self._bad_stamps = 0
        self._bag = Pipeline(bag, self._values["queue_mb"] * _MB, self._values["reserve_mb"] * _MB)
        self._lost_before = self._losses.lost.copy()
        now = self._now()
        for message in self._ring.latched():
            self._bag.put(message.topic, now, message.published, message.data)
        return folder

    def _on_start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        if self._bag is not None and (self._recording or self._drain is not None):
            response.message = f"expected no running recording, found {self._bag.folder}; stop it first"
            return response
        self._end_recording()
        try:
            response.path = str(self._start(self._folder(request.path, "softgrip")))
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
        self._drain, self._drained = Drain(asked, asked + to_ns(_DRAIN_LIMIT)), Future()
        try:
            await self._drained
            self._end_recording()
        finally:
            self._drain = None  # not earlier: until the bag is closed, what was sent after the moment stays out
        response.path = str(bag.folder)
        response.messages = bag.accepted - bag.removed.total()
        response.topics = len(self._topics)
        response.dropped = self._dropped(bag)
        response.success = bag.error is None
        response.message = "" if bag.error is None else self._why_stopped(bag)
        return response

    def _on_split(self, _: SplitRecording.Request, response: SplitRecording.Response) -> SplitRecording.Response:
        if self._bag is None:
            response.message = "expected a running recording, found none"
            return response
        try:
            response.path = str(self._bag.call(BagWriter.split).result(_SPLIT_LIMIT))
            response.success = True
        except Exception as error:  # noqa: BLE001  whatever ended the recording is the answer
            response.message = f"{self._bag.folder}: cannot be split: {error_text(error) or 'the disk is too slow'}"
        return response

    def _on_snapshot(
        self, request: SnapshotRecording.Request, response: SnapshotRecording.Response
    ) -> SnapshotRecording.Response:
        try:
            messages = self._ring.last(snapshot_seconds(request.seconds))
            response.path = str(self._write_snapshot(self._folder(request.path, "snapshot"), messages))
        except Exception as error:  # noqa: BLE001  whatever prevents it is the answer
            response.message = f"no snapshot: {error_text(error)}"
            return response
        response.success, response.messages = True, len(messages)
        return response

    def _write_snapshot(self, folder: Path, messages: Sequence[RawMessage], why: str = "") -> Path:
        self._check_reserve(folder, sum(len(message.data) for message in messages))
        bag = self._new_bag(folder, FileLimits())
        try:
            if why:
                bag.add_fact("softgrip_fault", {"fault": why})
            for message in messages:
                bag.write(message.topic, message.received, message.published, message.data)
            return bag.close()
        except BaseException:
            bag.abandon()
            raise

    def _snapshot_of_fault(self) -> None:
        """Write what led to a fault and what followed, on a thread: recording goes on meanwhile."""
        why = self._fault_watch.due(time.monotonic())
        requested = self._values["snapshot_on_fault"]
        if not why or requested == "never" or (requested == "unrecorded" and self._recording):
            return
        folder = self._folder("", "fault")
        messages = self._ring.last()

        def write() -> None:
            try:
                self._write_snapshot(folder, messages, why)
                self.get_logger().warning(f"kept the last seconds in {folder}: {why}")
            except Exception as error:  # noqa: BLE001  whatever prevents it is reported
                self.get_logger().error(f"{folder}: no snapshot of the fault: {error_text(error)}")

        self._snapshot_thread = threading.Thread(target=write, name="snapshot of a fault")
        self._snapshot_thread.start()

    @property
    def _recording(self) -> bool:
        return self._bag is not None and self._bag.error is None

    def _attach(self, attachment: Attachment) -> None:
        """Take along a node's parameters or a file, in this bag and those to come.

        Raises:
            BagError: there is too much of it already.
        """
        others = sum(len(one.data) for name, one in [*self._carried.items()] if name != attachment.name)
        if others + len(attachment.data) > _MAX_CARRIED:
            raise BagError(f"expected at most {_MAX_CARRIED} bytes of attachments, found more with {attachment.name}")
        self._carried[attachment.name] = attachment
        if self._bag is not None:
            self._bag.call(lambda bag: bag.attach(attachment))

    def _look(self) -> None:
        """Subscribe to topics that have appeared, ask nodes that have."""
        for name, types in self.get_topic_names_and_types():
            if not is_below(name, self._cell) and not any(is_shared(name, kind) for kind in types):
                continue  # another cell's
            if name not in self._unreadable and (name not in self._topics or len(types) > 1):
                publishers = self.get_publishers_info_by_topic(name)
                if name not in self._topics and publishers:
                    self._subscribe(name, publishers_type([info.topic_type for info in publishers]), publishers)
                self._look_at_types(name, types, [info.topic_type for info in publishers])
            elif len(types) == 1:
                self._conflicts.pop(name, None)
        self._snapshot_of_parameters.ask_nodes()
        self._snapshot_of_fault()
        self._report()
        if self._drain is not None and not self._drained.done() and self._drain.check_quiet(time.time_ns()):
            self._drained.set_result(None)

    def _look_at_types(self, name: str, types: Sequence[str], publishers: Sequence[str]) -> None:
        conflict = type_conflict(self._topics[name].type_name, publishers, types) if name in self._topics else ""
        if conflict:
            self._conflicts[name] = conflict
        else:
            self._conflicts.pop(name, None)

    def _report_topics(self) -> None:
        malformed = {name: f"{n} messages not of its type" for name, n in self._malformed.items()}
        problems = [f"{name}: {why}" for name, why in (self._conflicts | malformed | self._unreadable).items()]
        health = Health.ERROR if self._unreadable else Health.WARN if problems else Health.OK
        more = f"; and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
        said = "; ".join(problems[-_SHOWN:]) + more if problems else f"{len(self._topics)} topics"
        self._diagnostics.set("topics", health, said)
        refused = self._snapshot_of_parameters.refused
        said = "; ".join(refused[:_SHOWN]) if refused else "carried"
        self._diagnostics.set("parameters", Health.WARN if refused else Health.OK, said)

    def _why_stopped(self, bag: Pipeline) -> str:
        return (
            f"recording stopped: {bag.folder}: {error_text(bag.error)}; make room or repair, then call recorder/start"
        )

    def _report(self) -> None:
        self._report_topics()
        bag = self._bag
        behind, self._behind = self._behind, 0.0
        if bag is None and self._not_started:
            self._diagnostics.set("bag", Health.ERROR, f"not recording: {self._not_started}; then call recorder/start")
            return
        if bag is None:
            self._diagnostics.set("bag", Health.WARN, "not recording; call recorder/start")
            return
        values = {
            "messages": bag.accepted,
            "dropped": self._dropped(bag),
            "waiting_peak_bytes": bag.peak_bytes,
            "behind_s": round(behind, 3),
            "impossible_stamps": self._bad_stamps,
            "nodes_with_parameters": self._snapshot_of_parameters.nodes,
            "files_not_found": "; ".join(self._snapshot_of_parameters.missing),
        }
        if bag.error is not None:
            self._diagnostics.set("bag", Health.ERROR, self._why_stopped(bag), values)
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
        publishers = [info for info in publishers if info.topic_type == type_name]
        try:
            if len(self._topics) >= MAX_ID:
                raise BagError(f"expected at most {MAX_ID} topics, which is MCAP's limit, found one more")
            topic = Topic(
                name,
                type_name,
                str(publishers[0].topic_type_hash),
                schema_text(type_name, interface_text),
                tuple(offered(info.qos_profile) for info in publishers),
            )
            cls = message_class(type_name)
        except BagError as error:
            if len(self._unreadable) < MAX_ID:
                self._unreadable[name] = f"not recorded: {error}"
            return
        self._topics[name] = topic
        if self._bag is not None:
            self._bag.call(lambda bag: bag.add_topic(topic))
        simulated = bool(self.get_parameter("use_sim_time").value)
        latched = topic.latched
        faults = _FAULTS.get(type_name)
        single = len(publishers) == 1

        def on_message(data: bytes, info: MessageInfo) -> None:
            received = self._now() if simulated else info["received_timestamp"] or time.time_ns()
            published = info["source_timestamp"] or received
            if clamp_stamp(published) != published:
                self._bad_stamps += 1
                published = received
            if type_name == PARAMETER_EVENT:
                data = without_secrets(data)
            message = RawMessage(name, type_name, received, published, data)
            publisher = info.get("publisher_gid")
            if publisher is not None or single:
                self._losses.add_sequence(name, info["publication_sequence_number"], publisher)
            if not latched:
                self._behind = max(self._behind, to_s(received - message.published))
            self._ring.add(message, latched=latched)
            if faults is not None:
                self._watch_faults(name, faults, data, cls)
            # a recording ends on all topics at once, so that nothing in it follows from what is not
            requested = self._drain is None or self._drain.admit_message(message.published)
            if self._bag is not None and requested:
                self._bag.put(name, received, message.published, data)

        qos = matching(topic.qos, self._values["queue_depth"])
        callback = self._own_only(name, type_name, cls, on_message)
        self.create_subscription(cls, name, with_message_info(callback), qos, raw=True)

    def _own_only(self, name: str, type_name: str, cls: type[object], on_message: _OnMessage) -> _OnMessage:
        """Return the callback, for a topic of all cells one that drops the messages of the others."""
        if is_below(name, self._cell):
            return on_message

        def on_shared(data: bytes, info: MessageInfo) -> None:
            if self._is_own(name, type_name, data, cls):
                on_message(data, info)

        return on_shared

    def _is_own(self, name: str, type_name: str, data: bytes, cls: type[object]) -> bool:
        """Return whether a message on a topic of all cells comes from this one."""
        try:
            return is_of_cell(type_name, deserialize_message(data, cls), self._cell)
        except Exception:  # noqa: BLE001  each middleware has its own; what nobody can read is nobody's
            self._malformed[name] += 1
            return False

    def _watch_faults(self, name: str, faults: Callable[[Any], dict[str, str]], data: bytes, cls: type[object]) -> None:
        try:
            found = faults(deserialize_message(data, cls))
        except Exception:  # noqa: BLE001  each middleware has its own for bytes that are no such message
            self._malformed[name] += 1
            return
        self._fault_watch.observe_faults(found, time.monotonic())


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    sys.setswitchinterval(_SWITCH_INTERVAL)
    return run(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
