# SPDX-License-Identifier: Apache-2.0
"""Bags from before enumerations began with UNSET: written here by rosbags with the definitions of that time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from softgrip_bag import reader
from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import info, replay
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.messages import interface_text, message_class
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.offers import OfferedQos
from softgrip_bag.old_definitions import ENUMERATIONS, old_name
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.action import CalibrateFriction, Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import FrictionModel, FrictionSample, NodeTrace, PredictionResidual

#: As they stood in softgrip_interfaces at that time, without comments.
OLD = {
    "FrictionModel": """std_msgs/Header header
string id
string law
string k_reading
string[] coefficient_names
float64[] coefficients
float64[] covariance
float64 cable_radius
float64 surface_radius
float64[2] angle_range
float64[2] tension_range
float64 average_error
float64 maximum_error
float64 r_squared
float64 residual_stddev
uint32 degrees_of_freedom
uint32 points
string cable
string surface
string source
uint8 USABLE=0
uint8 REPEAT_POINTS=1
uint8 DO_NOT_USE=2
uint8 verdict
string reason
""",
    "FrictionSample": """std_msgs/Header header
string plan
uint32 index
float64 angle
float64 load
float64 tension_low
float64 tension_high
float64 tension_high_stddev
float64 stick_slip_amplitude
float64 drift
float64 speed
float64 window_start
float64 window_end
uint8 ACCEPTED=0
uint8 REPEAT=1
uint8 REJECTED=2
uint8 verdict
string reason
""",
    "PredictionResidual": """std_msgs/Header header
string finger
float64 pulled_length
float64 tip_error
float64 tip_error_percent
float64[] joint_angle_errors
float64 tension_error
float64 cusum_friction
float64 cusum_stiffness
uint8 OK=0
uint8 WATCH=1
uint8 RECALIBRATE=2
uint8 WORN=3
uint8 verdict
string reason
""",
}
HEADER = "std_msgs/msg/Header"
SEPARATOR = "=" * 80
STD = (
    f"{SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def typestore() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OLD.items():
        store.register(get_types_from_msg(text, f"softgrip_interfaces/msg/{name}"))
    return store


def old_message(store: Any, name: str, verdict: int) -> bytes:
    """Serialize with rosbags; every number and text differs from the others."""
    kind = store.types[f"softgrip_interfaces/msg/{name}"]
    values: dict[str, Any] = {}
    for number, (field, (node, detail)) in enumerate(store.get_msgdef(kind.__msgtype__).fields, start=1):
        if field == "header":
            stamp = store.types["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
            values[field] = store.types[HEADER](stamp=stamp, frame_id="palm")
        elif field == "verdict":
            values[field] = verdict
        elif node.name == "BASE":
            values[field] = f"text {number}" if detail[0] == "string" else number if "int" in detail[0] else number / 8
        elif detail[0][1][0] == "string":
            values[field] = [f"name {number}", "second"]
        else:
            values[field] = np.array([number / 4, number / 2])
    return bytes(store.serialize_cdr(kind(**values), kind.__msgtype__))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    store = typestore()
    made = BagWriter(tmp_path / "old")
    topics = {
        "/friction/active": "FrictionModel",
        "/rig/sample": "FrictionSample",
        "/finger/residual": "PredictionResidual",
    }
    for topic, name in topics.items():
        made.add_topic(Topic(topic, f"softgrip_interfaces/msg/{name}", "", OLD[name] + STD, (OfferedQos(),)))
    for verdict in (0, 1, 2, 9):
        for topic, name in topics.items():
            made.write(topic, 1_000 + verdict, 1_000 + verdict, old_message(store, name, verdict))
    made.write("/finger/residual", 2_000, 2_000, old_message(store, "PredictionResidual", 3))
    return made.close()


def verdicts(bag: Path, topic: str, kind: Any) -> list[int]:
    return [deserialize_message(raw.data, kind).verdict for raw in RecordedBag(bag).read({topic})]


def test_a_verdict_keeps_its_name_and_one_without_a_name_says_nothing(bag: Path) -> None:
    m, s, r = FrictionModel, FrictionSample, PredictionResidual
    assert verdicts(bag, "/friction/active", m) == [m.USABLE, m.REPEAT_POINTS, m.DO_NOT_USE, m.UNSET]
    assert verdicts(bag, "/rig/sample", s) == [s.ACCEPTED, s.REPEAT, s.REJECTED, s.UNSET]
    assert verdicts(bag, "/finger/residual", r) == [r.OK, r.WATCH, r.RECALIBRATE, r.UNSET, r.WORN]


def test_every_other_field_keeps_its_value_and_a_new_one_is_empty(bag: Path) -> None:
    raw = next(iter(RecordedBag(bag).read({"/friction/active"})))
    model = deserialize_message(raw.data, FrictionModel)
    assert (model.header.stamp.sec, model.header.stamp.nanosec, model.header.frame_id) == (7, 8, "palm")
    assert (model.id, model.law, list(model.coefficient_names)) == ("text 2", "text 3", ["name 5", "second"])
    assert (list(model.coefficients), list(model.angle_range)) == ([1.5, 3.0], [2.5, 5.0])
    assert (model.cable_radius, model.degrees_of_freedom, model.points) == (1.0, 16, 17)
    assert (model.cable, model.reason, model.digest) == ("text 18", "text 22", "")
    assert (raw.received, raw.published) == (1_000, 1_000)


def test_report_and_info_tell_what_the_bag_meant(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    story = digest(bag)
    assert story.fits[0].verdict == "USABLE"
    assert [sample.accepted for sample in story.samples] == [True, False, False, False]
    assert RecordedBag(bag).is_before_unset
    assert info.main([str(bag)]) == 0
    assert "softgrip_interfaces/msg/FrictionModel" in capsys.readouterr().out


def test_the_raw_reader_gives_the_bytes_as_they_were_recorded(bag: Path) -> None:
    raw = next(reader.read(bag, {"/friction/active"}))
    definitions = parse_definitions(raw.type_name, OLD["FrictionModel"] + STD)
    assert decode(raw.type_name, definitions, raw.data).values["verdict"] == 0
    for length in (3, 20, len(raw.data) // 2, len(raw.data) - 1):
        with pytest.raises(BagError, match="as the bag defines it"):
            decode(raw.type_name, definitions, raw.data[:length])


def test_a_bag_of_today_is_read_as_it_is(tmp_path: Path) -> None:
    made = BagWriter(tmp_path / "new")
    name = "softgrip_interfaces/msg/FrictionModel"
    made.add_topic(Topic("/friction/active", name, "", schema_text(name, interface_text), (OfferedQos(),)))
    data = bytes(serialize_message(FrictionModel(id="m", verdict=FrictionModel.USABLE, digest="d")))
    made.write("/friction/active", 1, 1, data)
    bag = made.close()
    assert [raw.data for raw in RecordedBag(bag).read()] == [data]
    assert not RecordedBag(bag).is_before_unset
    assert digest(bag).fits[0].verdict == "USABLE"


def test_the_outcome_of_an_old_grasp_keeps_its_name_and_its_replay_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with_trace = BagWriter(tmp_path / "trace")
    kind = "softgrip_interfaces/msg/NodeTrace"
    with_trace.add_topic(
        Topic("/grasp_mix_manager/trace", kind, "", schema_text(kind, interface_text), (OfferedQos(),))
    )
    with_trace.add_topic(
        Topic("/friction/active", "softgrip_interfaces/msg/FrictionModel", "", OLD["FrictionModel"] + STD, ())
    )
    results = [bytes(serialize_message(Grasp.Result(outcome=number, reason=f"r{number}"))) for number in range(5)]
    steps = NodeTrace(
        first=0,
        size=[len(data) for data in results],
        data=b"".join(results),
        **_step_fields(len(results), "finished /cell/grasp"),
    )
    with_trace.write("/grasp_mix_manager/trace", 1, 1, bytes(serialize_message(steps)))
    old = with_trace.close()
    assert [grasp.outcome for grasp in digest(old).grasps] == ["GRIPPED", "EMPTY", "SLIPPED", "TENDON_FAULT", "ABORTED"]
    assert replay.main([str(old), "--through", "grasp_mix_manager", "--check"]) == 2
    assert "needs softgrip of that time" in capsys.readouterr().err


def _step_fields(count: int, name: str) -> dict[str, Any]:
    """Fill the other fields of a trace: names are listed once, the rest is a number a step."""
    fields = NodeTrace.get_fields_and_field_types()
    filled: dict[str, Any] = {}
    for field, kind in fields.items():
        if field in {"first", "size", "data", "header"} or not kind.startswith("sequence"):
            continue
        filled[field] = [name] if "string" in kind else [0] * count
    return filled


def test_the_table_names_what_the_interfaces_have() -> None:
    """Each enumeration of the table is UNSET and then its names, in this order; none is forgotten."""
    classes = {
        "Grasp_Result": Grasp.Result,
        "SwapFingers_Result": SwapFingers.Result,
        "CalibrateFriction_Result": CalibrateFriction.Result,
        "MoveTendon_Goal": MoveTendon.Goal,
        "MoveTendon_Result": MoveTendon.Result,
    }
    for full, fields in ENUMERATIONS.items():
        package, name = full.split("/")
        kind = classes.get(name) or message_class(f"{package}/msg/{name}")
        for names in fields.values():
            assert kind.UNSET == 0
            assert [getattr(kind, one) for one in names] == list(range(1, len(names) + 1))
            assert old_name(full, next(iter(fields)), len(names)) == "UNSET"
