# SPDX-License-Identifier: Apache-2.0
"""Bags of older definitions: written here by rosbags with the definitions of their time."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag import reader
from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import info, replay
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.messages import interface_text, message_class
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.trace import TraceStep, runs
from softgrip_bag.offers import OfferedQos
from softgrip_bag.old_definitions import ENUMERATIONS
from softgrip_bag.schema_text import schema_text
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.action import CalibrateFriction, Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import FingerMarkers, FrictionModel, FrictionSample, NodeTrace, PredictionResidual
from softgrip_interfaces.msg import TraceStep as TraceStepMessage
from softgrip_interfaces.srv import ConfirmStep

pytest.importorskip("rosbags")
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

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


def test_info_into_a_pipe_that_is_closed_says_nothing(bag: Path) -> None:
    code = "input(); from softgrip_bag.nodes.commands.info import main; main()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code, str(bag)], stdin=pipe, stdout=pipe, stderr=pipe) as command:
        assert command.stdin is not None
        assert command.stdout is not None
        assert command.stderr is not None
        command.stdout.close()
        command.stdin.write(b"\n")
        command.stdin.close()
        assert command.stderr.read() == b""


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


def old_types(**texts: str) -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in texts.items():
        store.register(get_types_from_msg(text, f"softgrip_interfaces/msg/{name}"))
    return store


def header(store: Any) -> Any:
    return store.types[HEADER](stamp=store.types["builtin_interfaces/msg/Time"](sec=7, nanosec=8), frame_id="camera")


def one_topic(folder: Path, topic: str, name: str, text: str, data: Sequence[bytes]) -> Path:
    made = BagWriter(folder)
    made.add_topic(Topic(topic, f"softgrip_interfaces/msg/{name}", "", text + STD, (OfferedQos(),)))
    for number, one in enumerate(data, start=1):
        made.write(topic, number, number, one)
    return made.close()


MARKERS = """std_msgs/Header header
string finger
string[] names
float64[] u
float64[] v
float64[] x
float64[] y
float64[] stddev
float32[] confidence
bool[] occluded
float32 threshold_quality
string configuration
"""


def test_columns_of_markers_become_markers(tmp_path: Path) -> None:
    store = old_types(FingerMarkers=MARKERS)
    kind = store.types["softgrip_interfaces/msg/FingerMarkers"]
    columns = {name: np.array([number, number + 0.5]) for number, name in enumerate(("u", "v", "x", "y", "stddev"))}
    old = kind(
        header=header(store),
        finger="index",
        names=["base", "tip"],
        **columns,
        confidence=np.array([0.25, 0.75], np.float32),
        occluded=np.array([False, True]),
        threshold_quality=0.5,
        configuration="abc",
    )
    bag = one_topic(
        tmp_path / "bag", "/m", "FingerMarkers", MARKERS, [bytes(store.serialize_cdr(old, old.__msgtype__))]
    )
    (raw,) = RecordedBag(bag).read()
    found = deserialize_message(raw.data, FingerMarkers)
    assert (found.finger, found.threshold_quality, found.configuration) == ("index", 0.5, "abc")
    base, tip = found.markers
    assert [(one.name, one.u, one.v, one.x, one.y, one.stddev) for one in (base, tip)] == [
        ("base", 0.0, 1.0, 2.0, 3.0, 4.0),
        ("tip", 0.5, 1.5, 2.5, 3.5, 4.5),
    ]
    assert [(one.confidence, one.occluded) for one in (base, tip)] == [(0.25, False), (0.75, True)]


TRACE = """std_msgs/Header header
uint64 first
string[] names
uint16[] name
int64[] stamp
int64[] wall
int64[] monotonic
uint32[] size
uint8[] data
"""
RESULT = """uint8 outcome
string reason
string evidence
float64 latency
float64 duration
float64[] pulled_lengths
float64[] tensions
"""
RESULT_WITH_DECISION = RESULT.replace(
    "string evidence\n", "string evidence\nsoftgrip_interfaces/GraspEvidence decision\n"
)
FEEDBACK = "string phase\nfloat64[] pulled_lengths\nfloat64[] tensions\nbool contact\n"
EVIDENCE = "phase: hold\nexcess_n: {index: 1.5}\npeak_excess_n: {index: 2.5}\ndecided_stamp_ns: 5000000001\n"


def old_trace(folder: Path, steps: Sequence[tuple[str, bytes]]) -> BagWriter:
    """Return a bag with a trace of the time when its steps were columns."""
    store = old_types(NodeTrace=TRACE)
    names = sorted({name for name, _ in steps})
    count = len(steps)
    kind = store.types["softgrip_interfaces/msg/NodeTrace"]
    trace = kind(
        header=header(store),
        first=0,
        names=names,
        name=np.array([names.index(name) for name, _ in steps], np.uint16),
        stamp=np.arange(count),
        wall=np.arange(count) + 100,
        monotonic=np.arange(count) + 200,
        size=np.array([len(data) for _, data in steps], np.uint32),
        data=np.frombuffer(b"".join(data for _, data in steps), np.uint8),
    )
    made = BagWriter(folder)
    made.add_topic(
        Topic("/grasp_mix_manager/trace", "softgrip_interfaces/msg/NodeTrace", "", TRACE + STD, (OfferedQos(),))
    )
    made.write("/grasp_mix_manager/trace", 1, 1, bytes(store.serialize_cdr(trace, trace.__msgtype__)))
    return made


def old_result(outcome: int, evidence: str = "{}") -> bytes:
    store = old_types(Result=RESULT)
    kind = store.types["softgrip_interfaces/msg/Result"]
    empty = np.array([])
    made = kind(outcome, f"r{outcome}", evidence, latency=0.25, duration=4.0, pulled_lengths=empty, tensions=empty)
    return bytes(store.serialize_cdr(made, made.__msgtype__))


def test_steps_that_were_columns_become_steps_with_their_data(tmp_path: Path) -> None:
    store = old_types(Feedback=FEEDBACK)
    kind = store.types["softgrip_interfaces/msg/Feedback"]
    feedback = kind(phase="lift", pulled_lengths=np.array([0.01]), tensions=np.array([2.0]), contact=True)
    steps = [
        ("topic /tendon/state", b""),
        ("feedback /cell/grasp", bytes(store.serialize_cdr(feedback, feedback.__msgtype__))),
        ("finished /cell/grasp", old_result(3, EVIDENCE)),
    ]
    bag = RecordedBag(old_trace(tmp_path / "bag", steps).close())
    ((first, second, third),) = runs(bag, "/grasp_mix_manager/trace")
    assert (first.name, first.number, first.stamp_ns, first.time_ns, first.monotonic_ns) == (
        steps[0][0],
        0,
        0,
        100,
        200,
    )
    said = deserialize_message(second.data, Grasp.Feedback)
    assert (said.phase, list(said.pulled_lengths), said.contact) == (Grasp.Feedback.LIFT, [0.01], True)
    result = deserialize_message(third.data, Grasp.Result)
    assert (result.outcome, result.reason, result.latency) == (Grasp.Result.SLIPPED, "r3", 0.25)
    decision = result.decision
    assert (decision.phase, decision.stamp.sec, decision.stamp.nanosec) == (decision.HOLD, 5, 1)
    (index,) = decision.fingers
    assert (index.finger, index.contact_tension, index.peak_contact_tension) == ("index", 1.5, 2.5)
    assert np.isnan(index.tip_deviation)


SWAP_FEEDBACK = "string step\nstring instruction\nbool confirmation\nfloat64 elapsed\nstring token\n"
CONFIRM_STEP = "string step\nstring token\nstring[] serials\n"
FEEDBACK_MESSAGE = f"""unique_identifier_msgs/UUID goal_id
softgrip_interfaces/action/SwapFingers_Feedback feedback
{"=" * 80}
MSG: unique_identifier_msgs/UUID
uint8[16] uuid
{"=" * 80}
MSG: softgrip_interfaces/action/SwapFingers_Feedback
{SWAP_FEEDBACK}"""


def worded_swap(step: str, *token: str) -> list[tuple[str, bytes]]:
    """Feedback and confirmation of a swap's step, as traces had them when steps were words."""
    texts = {"SwapFeedback": SWAP_FEEDBACK, "Confirm": CONFIRM_STEP}
    store = old_types(**{name: text if token else text.replace("string token\n", "") for name, text in texts.items()})
    feedback = store.types["softgrip_interfaces/msg/SwapFeedback"](step, "Do it.", True, 1.5, *token)
    confirm = store.types["softgrip_interfaces/msg/Confirm"](step, *token, ["A", "B"])
    return [
        ("feedback /cell_2/cell/swap", bytes(store.serialize_cdr(feedback, feedback.__msgtype__))),
        ("request /cell_2/cell/confirm_step", bytes(store.serialize_cdr(confirm, confirm.__msgtype__))),
    ]


def check_swap(steps: Sequence[TraceStep], number: int, token: str = "0f2c") -> None:
    feedback = deserialize_message(steps[0].data, SwapFingers.Feedback)
    assert (feedback.step, feedback.instruction, feedback.confirmation) == (number, "Do it.", True)
    assert (feedback.elapsed, feedback.token) == (1.5, token)
    request = deserialize_message(steps[1].data, ConfirmStep.Request)
    assert (request.step, request.token, list(request.serials)) == (number, token, ["A", "B"])


def test_words_of_a_swap_in_a_trace_of_columns_become_numbers(tmp_path: Path) -> None:
    bag = RecordedBag(old_trace(tmp_path / "bag", worded_swap("insert", "0f2c")).close())
    (steps,) = runs(bag, "/grasp_mix_manager/trace")
    check_swap(steps, SwapFingers.Feedback.INSERT)


def test_words_of_a_swap_of_before_swaps_had_tokens_become_numbers(tmp_path: Path) -> None:
    made = old_trace(tmp_path / "bag", worded_swap("remove"))
    model = "softgrip_interfaces/msg/FrictionModel"
    made.add_topic(Topic("/friction/active", model, "", OLD["FrictionModel"] + STD, ()))  # it has no UNSET
    (steps,) = runs(RecordedBag(made.close()), "/grasp_mix_manager/trace")
    check_swap(steps, SwapFingers.Feedback.REMOVE, "")


def test_words_of_a_swap_in_a_trace_of_messages_become_numbers(tmp_path: Path) -> None:
    """Between two releases steps were messages already, and a swap's were words: its feedback's definition says so."""
    batch = NodeTrace(
        steps=[TraceStepMessage(name=name, data=data) for name, data in worded_swap("close_palm", "0f2c")]
    )
    made = BagWriter(tmp_path / "bag")
    trace, feedback = "softgrip_interfaces/msg/NodeTrace", "softgrip_interfaces/action/SwapFingers_FeedbackMessage"
    made.add_topic(Topic("/grasp_mix_manager/trace", trace, "", schema_text(trace, interface_text), (OfferedQos(),)))
    made.add_topic(Topic("/cell/swap/_action/feedback", feedback, "", FEEDBACK_MESSAGE, (OfferedQos(),)))
    made.write("/grasp_mix_manager/trace", 1, 1, bytes(serialize_message(batch)))
    (steps,) = runs(RecordedBag(made.close()), "/grasp_mix_manager/trace")
    check_swap(steps, SwapFingers.Feedback.CLOSE_PALM)


def test_a_swap_of_today_in_a_trace_is_left_alone(tmp_path: Path) -> None:
    said = SwapFingers.Feedback(step=SwapFingers.Feedback.HOME, instruction="Wait.", token="0f2c")
    step = TraceStepMessage(name="feedback /cell/swap", data=bytes(serialize_message(said)))
    made = BagWriter(tmp_path / "bag")
    for name, kind in (
        ("/grasp_mix_manager/trace", "softgrip_interfaces/msg/NodeTrace"),
        ("/cell/swap/_action/feedback", "softgrip_interfaces/action/SwapFingers_FeedbackMessage"),
    ):
        made.add_topic(Topic(name, kind, "", schema_text(kind, interface_text), (OfferedQos(),)))
    made.write("/grasp_mix_manager/trace", 1, 1, bytes(serialize_message(NodeTrace(steps=[step]))))
    ((found,),) = runs(RecordedBag(made.close()), "/grasp_mix_manager/trace")
    assert deserialize_message(found.data, SwapFingers.Feedback) == said


def test_a_result_with_yaml_and_numbers_keeps_its_numbers(tmp_path: Path) -> None:
    parts = {"FingerEvidence": interface_text("softgrip_interfaces", "msg", "FingerEvidence")}
    parts["GraspEvidence"] = interface_text("softgrip_interfaces", "msg", "GraspEvidence").replace(
        "FingerEvidence[]", "softgrip_interfaces/FingerEvidence[]"
    )
    store = old_types(**parts, Result=RESULT_WITH_DECISION)
    types = {
        name: store.types[f"softgrip_interfaces/msg/{name}"] for name in ("FingerEvidence", "GraspEvidence", "Result")
    }
    finger = types["FingerEvidence"]("thumb", 3, 1.5, 0.1, 0.4, 2.5, 3.0, 0.02)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    empty = np.array([])
    result = types["Result"](
        1, "held", "phase: hold", types["GraspEvidence"](stamp, 3, [finger]), 0.25, 4.0, empty, empty
    )
    data = bytes(store.serialize_cdr(result, result.__msgtype__))
    (grasp,) = digest(old_trace(tmp_path / "bag", [("finished /cell/grasp", data)]).close()).grasps
    assert (grasp.outcome, grasp.reason, grasp.latency, grasp.duration) == ("GRIPPED", "held", 0.25, 4.0)
    assert json.loads(grasp.evidence) == {
        "stamp_ns": 1_000_000_002,
        "phase": "HOLD",
        "fingers": [
            {
                "finger": "thumb", "state": "BLOCKED", "contact_tension": 1.5, "contact_tension_stddev": 0.1,
                "threshold": 0.4, "peak_contact_tension": 2.5, "max_force": 3.0, "tip_deviation": 0.02,
            }
        ],
    }  # fmt: skip


@pytest.mark.parametrize("data", [old_result(1) + bytes(8), old_result(1, "phase: [")], ids=["longer", "no YAML"])
def test_a_result_of_neither_time_is_refused(data: bytes, tmp_path: Path) -> None:
    bag = RecordedBag(old_trace(tmp_path / "bag", [("finished /cell/grasp", data)]).close())
    with pytest.raises(BagError, match="expected a softgrip_interfaces/action/Grasp_Result"):
        list(runs(bag, "/grasp_mix_manager/trace"))


def test_the_outcome_of_an_old_grasp_keeps_its_name_and_its_replay_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = old_trace(tmp_path / "trace", [("finished /cell/grasp", old_result(number)) for number in range(5)])
    made.add_topic(
        Topic("/friction/active", "softgrip_interfaces/msg/FrictionModel", "", OLD["FrictionModel"] + STD, ())
    )
    old = made.close()
    assert [grasp.outcome for grasp in digest(old).grasps] == ["GRIPPED", "EMPTY", "SLIPPED", "TENDON_FAULT", "ABORTED"]
    assert replay.main([str(old), "--through", "grasp_mix_manager"]) == 2
    assert "needs softgrip of that time" in capsys.readouterr().err


def test_the_table_names_what_the_interfaces_have() -> None:
    """Each enumeration of the table is UNSET and then its names, in this order; none is forgotten.

    Where two parts of an action have one, the second is called FIELD_UNSET.
    """
    classes = {
        "Grasp_Result": Grasp.Result,
        "Grasp_Feedback": Grasp.Feedback,
        "SwapFingers_Feedback": SwapFingers.Feedback,
        "SwapFingers_Result": SwapFingers.Result,
        "ConfirmStep_Request": ConfirmStep.Request,
        "CalibrateFriction_Result": CalibrateFriction.Result,
        "MoveTendon_Goal": MoveTendon.Goal,
        "MoveTendon_Result": MoveTendon.Result,
    }
    for full, fields in ENUMERATIONS.items():
        package, name = full.split("/")
        kind = classes.get(name) or message_class(f"{package}/msg/{name}")
        for field, names in fields.items():
            assert getattr(kind, f"{field.upper()}_UNSET", None) == 0 or kind.UNSET == 0
            numbers = [getattr(kind, one) for one in names]
            if kind is ConfirmStep.Request:  # counts as the feedback of a swap does, and says what has no feedback
                feedback = [getattr(SwapFingers.Feedback, one) for one in names[:-1]]
                assert numbers == [*feedback, SwapFingers.Feedback.VERIFY + 1]
            else:
                assert numbers == list(range(1, len(names) + 1))
