# SPDX-License-Identifier: Apache-2.0
"""What a node says hangs on the contents and stamps of its inputs: whatever their order of arrival, and in a replay."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import pytest
import rclpy
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.context import restore
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.nodes.messages import interface_text, message_class
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replay import NODES, NOT_RESULTS, check
from softgrip_bag.nodes.replayed_node import Output, ReplayedNode
from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import RawMessage, attachments
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.msg import CellState, MountedFinger
from softgrip_nodekit import input_stamp_ns, nanoseconds, to_time_message
from softgrip_testing.arrival_orders import arrive

BAGS = Path(__file__).resolve().parent / "bags"
MS = 1_000_000
LATENESS_NS = 200 * MS
LATCHED = ("/friction/active", "/cell/state")


@dataclass(frozen=True)
class Case:
    """A node, and a stretch of a bag: from so many messages of the driving stream after the first one on."""

    node: str
    bag: str
    driver: str
    first: int
    count: int
    arguments: tuple[str, ...] = ()
    paired: str = ""
    other: str = ""  # profile that the index finger is swapped for in the middle; empty: as recorded


CASES = {
    "predictor": Case(
        "kinematics_predictor",
        "closings",
        "/tendon/state",
        2160,
        130,
        ("-p", "joint_model:=flexure", "-p", "intervals:=all", "-p", "watch:=causes"),
        "/finger/measured",
    ),
    "simulator": Case("gdfe_simulator", "shapes", "/tendon/state", 0, 60, ("-p", "resolution:=coarse"), "", "power"),
    "tracker": Case("marker_tracker", "frames", "/camera/image_raw/compressed", 0, 14, (), "", "pinch"),
}
Streams = dict[str, list[tuple[int, RawMessage]]]


@contextmanager
def running(case: Case, folder: Path) -> Iterator[ReplayedNode]:
    arguments = restore(BAGS / case.bag, f"/{case.node}", folder).arguments
    rclpy.init(args=["--ros-args", "--log-level", "fatal", *arguments, *case.arguments])
    node = ReplayedNode(NODES[case.node].class_path)
    try:
        yield node
    finally:
        node.close()
        rclpy.try_shutdown()


def streams_of(case: Case) -> Streams:
    """Return topic -> (stamp [ns], message) of the stretch and what is latched before it.

    The last friction model is activated, and the fingers of a case are swapped, in its first half.
    """
    inputs = [raw for raw in RecordedBag(BAGS / case.bag).read() if raw.topic in {case.driver, case.paired, *LATCHED}]
    driving = [stamp_of(raw) for raw in inputs if raw.topic == case.driver]
    begin, end = driving[case.first], driving[case.first + case.count - 1]
    streams: Streams = {}
    models = [raw for raw in inputs if raw.topic == "/friction/active"]
    when = {raw: begin + (end - begin) // 4 if raw is models[-1] else raw.published for raw in models}
    for raw in (activated(each, when[each]) if each in when else each for each in inputs):
        stamp = stamp_of(raw)
        if begin <= stamp <= end or (raw.topic in LATCHED and stamp < begin):
            streams.setdefault(raw.topic, []).append((stamp, raw))
    for items in streams.values():
        items.sort(key=lambda each: each[0])
    if case.other:
        stamp = begin + (end - begin) // 3 - LATENESS_NS
        message = CellState(mounted=[MountedFinger(finger="index", profile=case.other, state=MountedFinger.VERIFIED)])
        message.header.stamp = to_time_message(stamp)
        like = next(raw for raw in inputs if raw.topic == "/cell/state")
        data = bytes(serialize_message(message))
        streams["/cell/state"] = [each for each in streams.get("/cell/state", []) if each[0] < stamp]
        streams["/cell/state"].append((stamp, replace(like, data=data, published=stamp, received=stamp)))
    return streams


def activated(raw: RawMessage, stamp: int) -> RawMessage:
    """Return a friction model that is active from a stamp [ns] on: bags of before do not say."""
    message = deserialize_message(raw.data, message_class(raw.type_name))
    message.activated = to_time_message(stamp)
    return replace(raw, data=bytes(serialize_message(message)))


def stamp_of(raw: RawMessage) -> int:
    return input_stamp_ns(deserialize_message(raw.data, message_class(raw.type_name)))


def said(case: Case, messages: Sequence[RawMessage], folder: Path) -> dict[str, list[Output]]:
    """Return what a node says to messages in their order of arrival: topic -> outputs."""
    outputs = defaultdict(list)
    with running(case, folder) as node:
        for message in messages:
            for output in node.feed(message):
                outputs[output.topic].append(output)
    return outputs


def results(outputs: dict[str, list[Output]]) -> dict[str, list[Any]]:
    """Return what does not measure the machine."""
    found: dict[str, list[Any]] = {}
    for topic, items in outputs.items():
        if topic not in NOT_RESULTS and not topic.endswith("/input_notes"):
            messages = [output.message for output in items]
            for message in messages:
                for field in {"solve_time", "rate"} & message.get_fields_and_field_types().keys():
                    setattr(message, field, 0.0)
            found[topic] = [bytes(serialize_message(message)) for message in messages]
    return found


def late(outputs: dict[str, list[Output]], case: Case) -> list[Any]:
    notes = [output.message for output in outputs[f"/{case.node}/input_notes"]]
    return [note for note in notes if note.topic != case.driver]


@pytest.fixture(scope="module", params=CASES)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A case, its streams, and what the node says when everything arrives at its stamp."""
    case = CASES[request.param]
    streams = streams_of(case)
    at_once = arrive(streams, dict.fromkeys(streams, 1), Random(0))
    return case, streams, said(case, [raw for _, raw in at_once], tmp_path_factory.mktemp("at_once"))


def test_the_stretch_has_a_change_and_every_result(recorded: Any) -> None:
    """Else the properties below would hold of nothing."""
    case, streams, outputs = recorded
    found = outputs[NODES[case.node].result]
    assert len(found) > 0.3 * len(streams[case.driver])
    assert len({output.message.configuration for output in found}) > 1
    assert late(outputs, case) == []
    if case.node == "kinematics_predictor":
        assert len(outputs["/finger/residual"]) > 10


@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32))
def test_any_order_of_arrival_within_the_lateness_gives_the_same_outputs(
    recorded: Any, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    case, streams, expected = recorded
    delays = dict.fromkeys(LATCHED, LATENESS_NS) | {case.driver: 20 * MS, "/finger/measured": 1900 * MS}
    arrived = [raw for _, raw in arrive(streams, delays, Random(seed))]
    outputs = said(case, arrived, tmp_path_factory.mktemp("order"))
    assert late(outputs, case) == []
    assert results(outputs) == results(expected)


@pytest.mark.parametrize("delay_ms", [150, 400])
def test_a_bag_is_replayed_whatever_the_order_in_which_node_and_recorder_got_it(
    recorded: Any, tmp_path: Path, delay_ms: int
) -> None:
    """What comes too late for the node it notes; the recorder gets all of it in yet another order."""
    case, streams, _ = recorded
    delayed = [
        (stamp + (delay_ms * MS if topic in LATCHED else 0), raw)
        for topic, items in streams.items()
        for stamp, raw in items
    ]
    arrived = [raw for _, raw in sorted(delayed, key=lambda each: each[0])]
    (tmp_path / "live").mkdir()
    outputs = said(case, arrived, tmp_path / "live")
    assert bool(late(outputs, case)) == (delay_ms * MS > LATENESS_NS)
    inputs = [raw for _, raw in arrive(streams, dict.fromkeys(streams, 3000 * MS), Random(8))]
    write_bag(tmp_path / "bag", case, inputs, outputs)
    found = check(tmp_path / "bag", case.node, case.arguments)
    assert found.divergence is None, str(found.divergence)
    assert found.compared == sum(len(items) for items in results(outputs).values())


def test_a_node_that_was_started_again_is_replayed_run_by_run(recorded: Any, tmp_path: Path) -> None:
    """It hears what is latched when it has answered three messages already; a wear test begins anew."""
    case, streams, _ = recorded
    arrived = [raw for _, raw in arrive(streams, dict.fromkeys(streams, 1), Random(0))]
    cut = len(arrived) * 3 // 5
    latched = list({raw.topic: raw for raw in arrived[:cut] if raw.topic in LATCHED}.values())
    driving = [number for number, raw in enumerate(arrived) if raw.topic == case.driver and number >= cut]
    outputs: dict[str, list[Output]] = defaultdict(list)
    runs = [arrived[:cut], [*arrived[cut : driving[3]], *latched, *arrived[driving[3] :]]]
    for number, run in enumerate(runs):
        (tmp_path / str(number)).mkdir()
        for topic, items in said(case, run, tmp_path / str(number)).items():
            outputs[topic] += items
    assert late(outputs, case)
    write_bag(tmp_path / "bag", case, arrived, outputs)
    found = check(tmp_path / "bag", case.node, case.arguments)
    assert found.divergence is None, str(found.divergence)
    assert found.compared == sum(len(items) for items in results(outputs).values())


def write_bag(folder: Path, case: Case, inputs: Sequence[RawMessage], outputs: dict[str, list[Output]]) -> None:
    """Write a bag as the recorder would."""
    bag = BagWriter(folder)
    for attachment in attachments(BAGS / case.bag):
        bag.attach(with_lateness(attachment, case))
    types = {raw.topic: raw.type_name for raw in inputs}
    kinds = {topic: items[0].kind for topic, items in outputs.items()}
    types |= {topic: f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}" for topic, kind in kinds.items()}
    for topic, kind in types.items():
        durability = "transient_local" if topic in LATCHED or topic.endswith("/input_notes") else "volatile"
        bag.add_topic(Topic(topic, kind, "", schema_text(kind, interface_text), (OfferedQos(durability=durability),)))
    received = max(stamp_of(raw) for raw in inputs) + 1000 * MS
    for number, raw in enumerate(inputs):
        bag.write(raw.topic, received + number * MS, received + number * MS, raw.data)
    for topic, items in outputs.items():
        for output in items:
            bag.write(topic, received + len(inputs) * MS, received + len(inputs) * MS, output.data)
    bag.close()


def with_lateness(attachment: Attachment, case: Case) -> Attachment:
    """Return a node's parameters with what only nodes have that order their inputs by stamp."""
    if attachment.name != f"parameters/{case.node}.yaml":
        return attachment
    values = yaml.safe_load(attachment.data)
    values[f"/{case.node}"]["ros__parameters"]["allowed_lateness_s"] = 1e-9 * LATENESS_NS
    return replace(attachment, data=yaml.safe_dump(values).encode())


def test_a_frame_that_is_measured_seconds_late_is_dropped_and_noted(tmp_path: Path) -> None:
    case = CASES["predictor"]
    streams = streams_of(replace(case, count=330))
    begin = streams[case.driver][0][0]
    streams["/finger/measured"] = [each for each in streams["/finger/measured"] if each[0] < begin + 900 * MS]
    times = {case.driver: 0, "/finger/measured": 2200 * MS}
    order = sorted(
        (
            (stamp + times.get(topic, 0), number, raw)
            for topic, items in streams.items()
            for number, (stamp, raw) in enumerate(items)
        ),
        key=lambda each: each[:2],
    )
    outputs = said(case, [raw for *_, raw in order], tmp_path)
    noted = late(outputs, case)
    assert noted
    assert {note.topic for note in noted} == {"/finger/measured"}
    assert all(nanoseconds(note.after) - nanoseconds(note.header.stamp) > 2_000 * MS for note in noted)
    assert len(noted) + len(outputs["/finger/residual"]) / 3 <= len(streams["/finger/measured"]) + 1
