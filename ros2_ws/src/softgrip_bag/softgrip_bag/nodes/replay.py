# SPDX-License-Identifier: Apache-2.0
"""Feed a bag through a node's own code, without middleware, and compare what it publishes with what it published then.

A node with topics only is a function of their contents and stamps (softgrip_nodekit/event_time.py), and is fed by these
(stamp_order.py); bags of before that was so are fed in the order of arrival that their results show (arrival_order.py).
A node with services and actions publishes a trace of its steps, which is followed to the letter (trace_replay.py).
"""

from __future__ import annotations

import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from softgrip_bag.comparison import NOT_COMPARED, Divergence, ReplayResult, first_difference
from softgrip_bag.context import NodeSetUp
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.arrival_order import feed_by_arrival
from softgrip_bag.nodes.messages import message_class, stamp_in, tree
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replayed_node import INFRASTRUCTURE, Fed, ReplayedNode
from softgrip_bag.nodes.stamp_order import NOTES, feed_by_stamp
from softgrip_bag.nodes.trace import MissingMessageError, TracedMessages, TraceStep, runs
from softgrip_bag.nodes.trace_replay import Diverged, ReplayIo, TraceComparison
from softgrip_bag.reader import RawMessage
from softgrip_nodekit import RecordingIo


@dataclass(frozen=True)
class ReplayableNode:
    """A node whose results depend on its inputs only.

    Attributes:
        class_path: module:class.
        result: topic that has one result for each message of the driving stream that the node worked on; empty: the
            node has a trace instead.
        drivers: the driving stream; the first of these topics that is in the bag.
        parameters: set for a replay whatever the bag says; ``{folder}`` is a temporary one.
        before: what the node did before it had these parameters; set for bags that do not have them.
    """

    class_path: str
    result: str = ""
    drivers: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    before: Mapping[str, str] = field(default_factory=dict)


NODES = {
    "kinematics_predictor": ReplayableNode(
        "softgrip_model.nodes.kinematics_predictor:KinematicsPredictor",
        "/finger/predicted",
        ("/tendon/state",),
        before={"joint_model": "hinge", "intervals": "friction", "watch": "shifts"},
    ),
    "gdfe_simulator": ReplayableNode(
        "softgrip_model.nodes.gdfe_simulator:GdfeSimulator", "/shape/predicted", ("/tendon/state",)
    ),
    "marker_tracker": ReplayableNode(
        "softgrip_vision.nodes.marker_tracker:MarkerTrackerNode",
        "/finger/markers",
        ("/camera/image_raw/compressed", "/camera/image_raw"),
    ),
    "grasp_mix_manager": ReplayableNode(
        "softgrip_cell.nodes.grasp_mix_manager:GraspMixManager",
        # what it remembered when it started is in the trace
        parameters=("database_url:=sqlite:///{folder}/cell.db", "catalogue:=''", "finger_records:=''"),
    ),
}
#: Topics of every node that are no results of it.
NOT_RESULTS = {*INFRASTRUCTURE, "/diagnostics"}
#: How far inputs may lag; a bag in which a node does not have it was recorded in order of arrival.
LATENESS = "allowed_lateness_s"


def check(bag: Path, name: str, ros_arguments: Sequence[str] = (), *, tolerance: float = 0.0) -> ReplayResult:
    """Feed a bag through a node and compare every result with the recorded one.

    The node is set up with the parameters, and the files they name, that the bag carries for it.

    Args:
        bag: folder or .mcap file.
        name: of the node, one of `NODES`.
        ros_arguments: win over what the bag carries, e.g. ["-p", "name:=value"].
        tolerance: relative, for bags of another machine; 0 = bit for bit.

    Raises:
        BagError: unknown node, or a bag that cannot be read or has no input of it.
    """
    if name not in NODES:
        raise BagError(f"expected one of {', '.join(NODES)}, found {name!r}")
    recording = RecordedBag(bag)
    recording.check_definitions()
    if NODES[name].result:
        return _compare(recording, _feed(recording, name, ros_arguments), tolerance)
    total = ReplayResult(0, None)
    for steps in _traced_runs(recording, name):
        result = _check_run(recording, name, steps, ros_arguments, tolerance)
        total = ReplayResult(
            total.compared + result.compared, result.divergence, total.without_input + result.without_input
        )
        if result.divergence:
            break
    return total


def renewed(bag: Path, name: str, ros_arguments: Sequence[str] = ()) -> dict[str, list[RawMessage]]:
    """Return what a node without services and actions says now to the recorded inputs, in place of what it said then.

    Returns:
        topic -> messages, received and published when their predecessors were.

    Raises:
        BagError: as `check` does.
    """
    recording = RecordedBag(bag)
    recording.check_definitions()
    fed = _feed(recording, name, ros_arguments)
    found: dict[str, list[RawMessage]] = {topic: [] for topic in fed.outputs}
    for raw, stamp, data in _answered(recording, fed, fed.outputs.keys()):
        if data is not None and stamp >= fed.start:
            found[raw.topic].append(replace(raw, data=data))
    return found


#: A node that kept up with an emulated cell's time has its times from the bag now, and no cell to wait for.
_NO_CELL = ("use_sim_time:=false", "lockstep:=''")


@contextmanager
def _set_up(recording: RecordedBag, name: str, ros_arguments: Sequence[str], level: str) -> Iterator[NodeSetUp]:
    """Give what a node that is made now is set up with."""
    with tempfile.TemporaryDirectory(prefix="softgrip-replay-") as folder:
        found = recording.set_up(name, Path(folder))
        own = [parameter.format(folder=folder) for parameter in NODES[name].parameters]
        before = {LATENESS: "0.0", **NODES[name].before}
        own += [f"{parameter}:={value}" for parameter, value in before.items() if parameter not in found.parameters]
        given = [*found.arguments, *(word for one in [*own, *_NO_CELL] for word in ("-p", one)), *ros_arguments]
        rclpy.init(args=["--ros-args", "--disable-rosout-logs", "--log-level", level, *given])
        try:
            yield found
        finally:
            rclpy.try_shutdown()


def _feed(recording: RecordedBag, name: str, ros_arguments: Sequence[str]) -> Fed:
    node = NODES[name]
    drivers = [recording.cell + driver for driver in node.drivers]
    driver = next((topic for topic in drivers if topic in recording.types), None)
    if driver is None:
        raise BagError(f"{recording.path}: expected a topic {' or '.join(drivers)}, found none; is it a bag of a cell?")
    nodes: list[ReplayedNode] = []

    def make() -> ReplayedNode:
        nodes.append(ReplayedNode(node.class_path))
        return nodes[-1]

    with _set_up(recording, name, ros_arguments, "warn") as set_up:
        feed = feed_by_stamp if LATENESS in set_up.parameters else feed_by_arrival
        try:
            return feed(recording, make, driver, recording.cell + node.result)
        finally:
            for each in nodes:
                each.close()


def _traced_runs(recording: RecordedBag, name: str) -> Iterator[list[TraceStep]]:
    topic = f"{recording.cell}/{name}/trace"
    if topic not in recording.types:
        raise BagError(f"{recording.path}: expected the topic {topic}, found none; was {name} recorded?")
    if recording.is_before_unset:
        raise BagError(
            f"{recording.path}: expected steps of {name} with today's actions, found a bag from before enumerations "
            "began with UNSET and orders had leases; report, export and info read it, replay needs softgrip of that "
            "time"
        )
    return runs(recording, topic)


def _check_run(
    recording: RecordedBag, name: str, steps: list[TraceStep], ros_arguments: Sequence[str], tolerance: float
) -> ReplayResult:
    """Make a node take the steps of one run again."""
    log = TraceComparison(name, steps, tolerance)
    io: list[ReplayIo] = []
    node: ReplayedNode | None = None

    def make(node: Node) -> RecordingIo:
        io.append(ReplayIo(node, log, TracedMessages(recording, steps)))
        return RecordingIo(node, io[0], log)

    with _set_up(recording, name, ros_arguments, "fatal"):
        try:
            node = ReplayedNode(NODES[name].class_path, node_io=make)
            end, without_input = steps[-1].time_ns, 0
            try:
                io[0].run()
            except MissingMessageError:
                end, without_input = log.next_step.time_ns - 1, log.pending
            outputs = defaultdict(list)
            for output in node.published():
                outputs[output.topic].append(output)
            fed = Fed(outputs, steps[0].time_ns, {step.time_ns for step in steps}, node.topics, end)
            found = _compare(recording, fed, tolerance)
            return ReplayResult(log.compared + found.compared, found.divergence, without_input)
        except Diverged as found_difference:
            return ReplayResult(log.compared, found_difference.divergence)
        finally:
            for each in io:
                each.close()
            if node is not None:
                node.close()


def _compare(recording: RecordedBag, fed: Fed, tolerance: float) -> ReplayResult:
    """Compare the results that were computed from what was fed; a topic that has fallen silent differs, too."""
    compared = without_input = 0
    for raw, stamp, data in _answered(recording, fed, fed.topics):
        if stamp < fed.start or (fed.end is not None and stamp > fed.end):
            continue
        if data is None and stamp not in fed.stamps:
            without_input += 1
            continue
        compared += 1
        difference = _difference(raw, data, tolerance)
        if difference:
            return ReplayResult(compared, Divergence(raw.topic, stamp, *difference), without_input)
    return ReplayResult(compared, None, without_input)


def _difference(raw: RawMessage, data: bytes | None, tolerance: float) -> tuple[str, object, object] | None:
    if data is None:
        return "(message)", "published", "not published"
    if data == raw.data:
        return None  # the same bytes say the same
    kind = message_class(raw.type_name)
    recorded, replayed = (tree(deserialize_message(item, kind)) for item in (raw.data, data))
    return first_difference(recorded, replayed, NOT_COMPARED.get(raw.type_name, frozenset()), tolerance=tolerance)


def _answered(
    recording: RecordedBag, fed: Fed, among: AbstractSet[str]
) -> Iterator[tuple[RawMessage, int, bytes | None]]:
    """Yield each recorded result of a node, on topics ``among`` these, with its stamp [ns], and the replayed one."""
    topics = {topic for topic in among & recording.types.keys() - NOT_RESULTS if not topic.endswith(f"/{NOTES}")}
    keys = _OutputKeys()
    replayed = {
        (topic, *keys.next_key(topic, output.data, output.kind)): output.data
        for topic in topics
        for output in fed.outputs.get(topic, ())
    }
    keys = _OutputKeys()
    for raw in recording.read(topics):
        key = keys.next_key(raw.topic, raw.data, message_class(raw.type_name))
        yield raw, key[0], replayed.get((raw.topic, *key))


class _OutputKeys:
    """Tells the messages of a topic apart by stamp, finger, and which of those with both it is."""

    def __init__(self) -> None:
        self._seen: Counter[tuple[str, int, str]] = Counter()

    def next_key(self, topic: str, data: bytes, kind: Any) -> tuple[int, str, int]:
        finger = str(deserialize_message(data, kind).finger) if "finger" in kind.get_fields_and_field_types() else ""
        stamp = stamp_in(data, kind)
        self._seen[topic, stamp, finger] += 1
        return stamp, finger, self._seen[topic, stamp, finger]
