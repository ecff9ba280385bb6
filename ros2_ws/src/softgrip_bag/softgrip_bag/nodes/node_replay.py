# SPDX-License-Identifier: Apache-2.0
"""Feed a bag through a node's own code, without middleware, and compare what it publishes with what it published then.

Two things of the recorded run a bag does not show directly: which messages of a best-effort stream the node really got,
and whether a latched message reached the node before or after a neighbour on another topic. Both are read off the
recorded results: each carries the stamp of the message it was computed from and the ids of the configuration it was
computed with (docs/conventions.md). A node with services and actions publishes a trace of its steps instead, which is
followed to the letter.
"""

from __future__ import annotations

import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import rclpy
from rclpy.serialization import deserialize_message

from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.comparison import NOT_COMPARED, Divergence, ReplayResult, first_difference
from softgrip_bag.context import restore
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.captured import INFRASTRUCTURE, Output, ReplayedNode
from softgrip_bag.nodes.input_feed import InputFeed, results_of
from softgrip_bag.nodes.old_messages import is_before_unset, is_older, read
from softgrip_bag.nodes.steps import Messages, MissingMessageError, TraceStep, runs, stamp_in
from softgrip_bag.nodes.trace_replay import Diverged, ReplayIo
from softgrip_bag.nodes.trees import tree
from softgrip_bag.nodes.types import check_definition, message_class
from softgrip_bag.reader import RawMessage, topic_summaries, topic_types


@dataclass(frozen=True)
class Replayable:
    """A node whose results depend on its inputs and their stamps only.

    Attributes:
        class_path: module:class.
        result: topic that has one result for each message of the driving stream that the node worked on.
        drivers: the driving stream; the first of these topics that is in the bag.
        trace: topic with the node's steps; then the two above are not needed.
        parameters: set for a replay whatever the bag says; ``{folder}`` is a temporary one.
    """

    class_path: str
    result: str = ""
    drivers: tuple[str, ...] = ()
    trace: str = ""
    parameters: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ""

    def in_cell(self, namespace: str) -> Replayable:
        """Return the node as it lives in the namespace of a cell ("" or "/cell_2")."""
        return replace(
            self,
            result=self.result and namespace + self.result,
            drivers=tuple(namespace + driver for driver in self.drivers),
            trace=self.trace and namespace + self.trace,
            namespace=namespace,
        )

    @property
    def arguments(self) -> tuple[str, ...]:
        """ROS arguments that put the node there."""
        return ("-r", f"__ns:={self.namespace}") if self.namespace else ()


NODES = {
    "kinematics_predictor": Replayable(
        "softgrip_model.nodes.kinematics_predictor:KinematicsPredictor", "/finger/predicted", ("/tendon/state",)
    ),
    "gdfe_simulator": Replayable(
        "softgrip_model.nodes.gdfe_simulator:GdfeSimulator", "/shape/predicted", ("/tendon/state",)
    ),
    "marker_tracker": Replayable(
        "softgrip_vision.nodes.marker_tracker:MarkerTrackerNode",
        "/finger/markers",
        ("/camera/image_raw/compressed", "/camera/image_raw"),
    ),
    "grasp_mix_manager": Replayable(
        "softgrip_cell.nodes.grasp_mix_manager:GraspMixManager",
        trace="/grasp_mix_manager/trace",
        # what it remembered when it started is in the trace
        parameters={"database_url": "sqlite:///{folder}/cell.db", "catalogue": "''", "finger_records": "''"},
    ),
}
#: Topics of every node that are no results of it.
NOT_RESULTS = {*INFRASTRUCTURE, "/diagnostics"}


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
    types = _checked_types(bag)
    replayable = NODES[name].in_cell(cell_namespace(types))
    if replayable.trace:
        return _check_traced(bag, name, types, ros_arguments, tolerance)
    with tempfile.TemporaryDirectory(prefix="softgrip-replay-") as folder:
        recorded = restore(bag, f"{replayable.namespace}/{name}", Path(folder))
        replayed, start, fed = _feed(bag, replayable, types, [*recorded, *ros_arguments])
    return _compare(bag, replayed, types, start, fed, tolerance)


def renewed(bag: Path, name: str, ros_arguments: Sequence[str] = ()) -> dict[str, list[RawMessage]]:
    """Return what a node without services and actions says now to the recorded inputs, in place of what it said then.

    Returns:
        topic -> messages, received and published when their predecessors were.

    Raises:
        BagError: as `check` does.
    """
    types = _checked_types(bag)
    replayable = NODES[name].in_cell(cell_namespace(types))
    with tempfile.TemporaryDirectory(prefix="softgrip-replay-") as folder:
        recorded = restore(bag, f"{replayable.namespace}/{name}", Path(folder))
        replayed, start, _ = _feed(bag, replayable, types, [*recorded, *ros_arguments])
    keys = _Keys()
    by_key = {topic: {keys.of(topic, o.data, o.kind): o for o in outputs} for topic, outputs in replayed.items()}
    keys = _Keys()
    found: dict[str, list[RawMessage]] = {topic: [] for topic in by_key}
    for raw in read(bag, set(by_key)):
        key = keys.of(raw.topic, raw.data, message_class(raw.type_name))
        output = by_key[raw.topic].get(key)
        if output is not None and key[0] >= start:
            found[raw.topic].append(replace(raw, data=output.data))
    return found


def _checked_types(bag: Path) -> dict[str, str]:
    for topic in topic_summaries(bag):
        if topic.type_name.startswith("softgrip_interfaces/") and topic.messages and not is_older(topic):
            check_definition(topic)
    return topic_types(bag)


def _feed(
    bag: Path, replayable: Replayable, types: Mapping[str, str], ros_arguments: Sequence[str]
) -> tuple[dict[str, list[Output]], int, set[int]]:
    """Return topic -> results, the stamp from which on they are complete, and the stamps of all that was fed [ns]."""
    driver = next((topic for topic in replayable.drivers if topic in types), None)
    if driver is None:
        raise BagError(f"{bag}: expected a topic {' or '.join(replayable.drivers)}, found none; is it a bag of a cell?")
    given = [*replayable.arguments, *ros_arguments]
    rclpy.init(args=["--ros-args", "--disable-rosout-logs", "--log-level", "warn", *given])
    nodes: list[ReplayedNode] = []
    try:

        def make() -> ReplayedNode:
            nodes.append(ReplayedNode(replayable.class_path))
            return nodes[-1]

        replay = InputFeed(bag, make, driver, replayable.result, results_of(bag, replayable.result, types))
        replayed = replay.run(types)
        results = {t: o for t, o in replayed.items() if t in types and t not in NOT_RESULTS}
        return results, replay.start, replay.stamps
    finally:
        for node in nodes:
            node.close()
        rclpy.try_shutdown()


def _check_traced(
    bag: Path, name: str, types: Mapping[str, str], ros_arguments: Sequence[str], tolerance: float
) -> ReplayResult:
    replayable = NODES[name].in_cell(cell_namespace(types))
    if replayable.trace not in types:
        raise BagError(f"{bag}: expected the topic {replayable.trace}, found none; was {name} recorded?")
    if is_before_unset(bag):
        raise BagError(
            f"{bag}: expected steps of {name} with today's actions, found a bag from before enumerations began with "
            "UNSET and orders had leases; report, export and info read it, replay needs softgrip of that time"
        )
    compared = without_input = 0
    for steps in runs(bag, replayable.trace):
        with tempfile.TemporaryDirectory(prefix="softgrip-replay-") as folder:
            own = [w for p, v in replayable.parameters.items() for w in ("-p", f"{p}:={v.format(folder=folder)}")]
            arguments = [*restore(bag, f"{replayable.namespace}/{name}", Path(folder)), *own, *ros_arguments]
            result = _check_run(bag, replayable, steps, types, arguments, tolerance)
        compared += result.compared
        without_input += result.without_input
        if result.divergence:
            return ReplayResult(compared, result.divergence, without_input)
    return ReplayResult(compared, None, without_input)


def _check_run(
    bag: Path,
    replayable: Replayable,
    steps: Sequence[TraceStep],
    types: Mapping[str, str],
    ros_arguments: Sequence[str],
    tolerance: float,
) -> ReplayResult:
    """Have a node take the steps of one run again."""
    topics = {step.name.removeprefix("topic ") for step in steps if step.name.startswith("topic ")}
    messages = Messages(bag, topics)
    given = [*replayable.arguments, *ros_arguments]
    rclpy.init(args=["--ros-args", "--disable-rosout-logs", "--log-level", "fatal", *given])
    node_io: list[ReplayIo] = []
    replayed: ReplayedNode | None = None

    def make(node: Any) -> ReplayIo:
        node_io.append(ReplayIo(node, steps, messages, tolerance))
        return node_io[0]

    try:
        replayed = ReplayedNode(replayable.class_path, node_io=make)
        end, without_input = steps[-1].wall, 0
        try:
            node_io[0].run()
        except MissingMessageError:
            end, without_input = node_io[0].now_ns() - 1, node_io[0].pending
        outputs: dict[str, list[Output]] = defaultdict(list)
        for output in replayed.published():
            if output.topic in types and output.topic not in NOT_RESULTS:
                outputs[output.topic].append(output)
        found = _compare(bag, outputs, types, steps[0].wall, {step.wall for step in steps}, tolerance, end)
        return ReplayResult(node_io[0].compared + found.compared, found.divergence, without_input)
    except Diverged as found_difference:
        return ReplayResult(node_io[0].compared, found_difference.divergence)
    finally:
        for each in node_io:
            each.close()
        if replayed is not None:
            replayed.close()
        rclpy.try_shutdown()


def _compare(
    bag: Path,
    replayed: Mapping[str, list[Output]],
    types: Mapping[str, str],
    start: int,
    fed: AbstractSet[int],
    tolerance: float,
    end: int | None = None,
) -> ReplayResult:
    """Compare from ``start`` [ns] on, to ``end``: what was computed from messages older than the bag cannot come out.

    ``fed`` are the stamps [ns] of the inputs: an output keeps the stamp of its input, and where the recorder missed a
    message of a best-effort stream that the node got, there is nothing to compute that output from.
    """
    keys = _Keys()
    by_key = {topic: {keys.of(topic, o.data, o.kind): o for o in outputs} for topic, outputs in replayed.items()}
    keys = _Keys()
    compared = without_input = 0
    for raw in read(bag, set(by_key)):
        kind = message_class(raw.type_name)
        key = keys.of(raw.topic, raw.data, kind)
        if key[0] < start or (end is not None and key[0] > end):
            continue
        output = by_key[raw.topic].get(key)
        if output is None and key[0] not in fed:
            without_input += 1
            continue
        compared += 1
        if output is None:
            difference = Divergence(raw.topic, key[0], "(message)", "published", "not published")
            return ReplayResult(compared, difference, without_input)
        if output.data == raw.data:
            continue  # the same bytes say the same
        skip = NOT_COMPARED.get(types[raw.topic], frozenset())
        recorded = deserialize_message(raw.data, kind)
        found = first_difference(tree(recorded), tree(output.message), skip, tolerance=tolerance)
        if found:
            return ReplayResult(compared, Divergence(raw.topic, key[0], *found), without_input)
    return ReplayResult(compared, None, without_input)


class _Keys:
    """Tells the messages of a topic apart by stamp, finger, and which of those with both it is."""

    def __init__(self) -> None:
        self._seen: Counter[tuple[str, int, str]] = Counter()

    def of(self, topic: str, data: bytes, kind: Any) -> tuple[int, str, int]:
        finger = str(deserialize_message(data, kind).finger) if "finger" in kind.get_fields_and_field_types() else ""
        stamp = stamp_in(data, kind)
        self._seen[topic, stamp, finger] += 1
        return stamp, finger, self._seen[topic, stamp, finger]
